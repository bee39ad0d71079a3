"""How a command is started and waited for: as a child of this process, or as a task of Ray.

Both run the very same command with the same output file, in a session of its own, and both end it with SIGINT.
Machines of a Ray cluster see this tree, its .venv and the run folders under the same paths (a shared folder).
"""

import logging
import os
import signal
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

from tandem.processes import Child, Command

POLL_S = 0.1


class MachineError(Exception):
    """A sentence: what can't be used, or was lost, and the remedy."""


class Task(Protocol):
    """A command that was started."""

    def poll(self) -> int | None:
        """Exit code (negative: killed by that signal), None while it runs. @raises MachineError when it is lost."""

    def interrupt(self) -> None:
        """Asks it to end in good order (SIGINT)."""


class Machine(Protocol):
    cores: int

    def start(self, name: str, command: Command, out: Path) -> Task:
        """Starts a command; stdout and stderr are appended to `out`."""

    def close(self) -> None:
        """Gives back what the machine holds."""


# ---- this machine


class _LocalTask:
    def __init__(self, child: Child, give_back: Callable[[], None]) -> None:
        self.child = child
        self.give_back = give_back  # its cores

    def poll(self) -> int | None:
        code = self.child.poll()
        if code is not None:
            self.give_back()
        return code

    def interrupt(self) -> None:
        self.child.send(signal.SIGINT)


class ThisMachine:
    """Children of this process; they end in good order when it dies, kill -9 included.

    Each of `jobs` [all cores] has cores of its own: trainings that share theirs wait for one another at every step.
    """

    def __init__(self, jobs: int | None = None) -> None:
        cores = sorted(os.sched_getaffinity(0))
        self.cores = len(cores)
        self._shares = shares(cores, jobs or self.cores)

    def start(self, name: str, command: Command, out: Path) -> Task:
        share = self._shares.pop(0) if self._shares else []
        return _LocalTask(Child(name, command, out, cores=share), lambda: self._give_back(share))

    def _give_back(self, share: list[int]) -> None:
        if share and share not in self._shares:
            self._shares.append(share)

    def close(self) -> None:
        pass


def shares(cores: Sequence[int], jobs: int) -> list[list[int]]:
    """The cores of each of so many runs at a time, none twice; empty when there are fewer cores than runs."""
    return [list(cores[i::jobs]) for i in range(jobs)] if jobs <= len(cores) else []


# ---- Ray


class _RayTask:
    def __init__(self, ray: Any, reference: Any) -> None:
        self.ray = ray
        self.reference = reference

    def poll(self) -> int | None:
        done, _ = self.ray.wait([self.reference], timeout=0)
        if not done:
            return None
        try:
            return int(self.ray.get(self.reference))
        except self.ray.exceptions.TaskCancelledError:
            return 128 + signal.SIGINT
        except self.ray.exceptions.RayError as error:
            raise MachineError(f"Ray lost it ({str(error).strip().splitlines()[0]})") from None

    def interrupt(self) -> None:
        self.ray.cancel(self.reference, force=False)


class RayMachine:
    """Tasks of Ray. address: `local` (an instance of its own, ended with us), `auto`, or HOST:PORT.

    When this process is killed (-9), Ray kills the commands alike; a training goes on after that as after any kill.
    """

    def __init__(self, address: str, jobs: int | None = None) -> None:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nothing is reported to anybody
        try:
            import ray
        except ImportError as error:
            raise MachineError(
                f"--ray needs Ray, which can't be loaded ({error}); install it by"
                " .venv/bin/python -m pip install --no-deps -r requirements-ray.txt, or leave out --ray."
            ) from None
        self.ray = ray
        local: dict[str, Any] = {}
        if address == "local":
            # Runs pass nothing through Ray's object store: the smallest will do.
            cores = len(os.sched_getaffinity(0))
            local = {"num_cpus": cores, "include_dashboard": False, "object_store_memory": 100 << 20}
        try:
            ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR, **local)
        except (ConnectionError, OSError, RuntimeError, ValueError) as error:
            raise MachineError(
                f"--ray {address}: Ray can't be reached there ({str(error).strip().splitlines()[0]});"
                " give local, auto (a cluster that `ray start` began) or HOST:PORT."
            ) from None
        self.cores = max(1, int(ray.cluster_resources().get("CPU", 1)))
        share = min(1.0, self.cores / jobs) if jobs else 1.0
        remote = ray.remote(num_cpus=share, max_retries=0, scheduling_strategy="SPREAD")
        self._carry_out = remote(carry_out)

    def start(self, name: str, command: Command, out: Path) -> Task:
        environment = {
            key: value
            for key, value in os.environ.items()
            if key == "PYTHONPATH" or key.startswith("TANDEM_")
        }
        words = [str(word) for word in command]
        return _RayTask(self.ray, self._carry_out.remote(name, words, str(out), environment))

    def close(self) -> None:
        self.ray.shutdown()


def carry_out(name: str, command: list[str], out: str, environment: dict[str, str]) -> int:
    """In a worker of Ray: runs the command to its end. Returns its exit code.

    A cancelled task gets a KeyboardInterrupt; the command is told, and still waited for.
    """
    child = None
    while True:
        try:
            child = child or Child(name, command, Path(out), environment=environment)
            while (code := child.poll()) is None:
                time.sleep(POLL_S)
            return code
        except KeyboardInterrupt:
            if child is None:
                return 128 + signal.SIGINT
            child.send(signal.SIGINT)
