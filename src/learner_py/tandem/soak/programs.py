"""The three programs of a training, each of which may be paused, killed and started again."""

from __future__ import annotations

import signal
import time

from tandem import processes
from tandem.processes import Child, Command
from tandem.run_folder import RunFolder, program


class Programs:
    """controller, learner and operator, started as `tandem train` starts them."""

    def __init__(self, folder: RunFolder, lcm_url: str) -> None:
        common: Command = ["--scenario", folder.scenario, "--lcm-url", lcm_url]
        results = folder.path / "controller.json"
        self._folder = folder
        self._commands: dict[str, Command] = {
            "learner": [*processes.learner_command(), *common, "--run", folder.path],
            "controller": [
                program("tandem_controller"),
                *common,
                "--run",
                folder.path,
                "--results",
                results,
            ],
            "operator": [program("tandem_operator"), *common],
        }
        self.children: dict[str, Child] = {}
        self._killed: set[str] = set()
        self.started_at: dict[str, float] = {}  # s, monotonic, latest start

    def missing(self) -> str | None:
        """A sentence when a program is not built."""
        sentences = [processes.missing_program(command) for command in self._commands.values()]
        return next((sentence for sentence in sentences if sentence), None)

    def start_all(self) -> None:
        for name in self._commands:
            self.start(name)

    def start(self, name: str) -> None:
        """From the main thread only: children end with the thread that started them."""
        self._killed.discard(name)
        self.children[name] = Child(name, self._commands[name], self._folder.path / f"{name}.out")
        self.started_at[name] = time.monotonic()

    def kill(self, name: str) -> None:
        self._killed.add(name)
        self.children[name].send(signal.SIGKILL)
        self.children[name].wait(5.0)

    def pause(self, name: str) -> None:
        self.children[name].send(signal.SIGSTOP)

    def go_on(self, name: str) -> None:
        self.children[name].send(signal.SIGCONT)

    def alive(self, name: str) -> bool:
        return name in self.children and self.children[name].poll() is None

    def ended_by_themselves(self) -> list[Child]:
        """Programs that ended though nobody killed them."""
        return [
            child
            for name, child in self.children.items()
            if name not in self._killed and child.poll() is not None
        ]

    def end_all(self) -> None:
        """Whatever still runs: the controller first, so that the arm holds."""
        for name, patience_s in {"controller": 10.0, "operator": 5.0, "learner": 30.0}.items():
            if self.alive(name):
                self.go_on(name)
                self.children[name].stop(patience_s)
