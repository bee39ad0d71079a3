"""Child processes that never outlive us: their start, their output, their orderly end."""

import contextlib
import ctypes
import os
import random
import shlex
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from tandem.run_folder import ROOT

_libc = ctypes.CDLL(None, use_errno=True)
_PR_SET_PDEATHSIG = 1

Command = Sequence[str | Path]

LEARNER_STAND_IN = "TANDEM_LEARNER"  # environment: a command line that takes the learner's place in tests

MULTICAST_GROUP = "239.255.76.67"
_PORTS = (
    7700,
    7999,
)  # LCM's own default is 7667; runs keep off it

# How a program that was asked to stop may end: by itself, by the shell's convention, or by the signal.
STOPPED = (0, 128 + signal.SIGINT, 128 + signal.SIGTERM, -signal.SIGINT, -signal.SIGTERM)


def free_lcm_url() -> str:
    """An LCM address on this machine (ttl 0) whose port nobody listens to now."""
    ports = list(range(*_PORTS))
    random.SystemRandom().shuffle(ports)
    for port in ports:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", port))
            except OSError:
                continue
        return f"udpm://{MULTICAST_GROUP}:{port}?ttl=0&recv_buf_size={receive_buffer()}"
    raise OSError(f"all UDP ports in {_PORTS} are taken")


def receive_buffer() -> int:
    """Socket buffer to ask for, bytes: 2 MiB hold the burst at the end of an episode, if we get them."""
    return min(2 << 20, int(Path("/proc/sys/net/core/rmem_max").read_text()))


class Child:
    """One program in a process group of its own, stdout and stderr appended to a file.

    With `terminal` it stays in our group and has our terminal; only its stderr goes to the file. `cores`: those that it
    and its children may use; none said: ours.

    It gets SIGTERM when the thread that started it dies, kill -9 included, so start it from the main thread.
    """

    def __init__(
        self,
        name: str,
        command: Command,
        out: Path,
        nice: int = 0,
        environment: dict[str, str] | None = None,
        terminal: bool = False,
        cores: Sequence[int] = (),
    ) -> None:
        self._grouped = not terminal
        self.name = name
        self.command = [str(part) for part in command]
        self.out = out
        out.parent.mkdir(parents=True, exist_ok=True)
        self._out_start = out.stat().st_size if out.exists() else 0
        parent = os.getpid()

        def in_child() -> None:
            # A worker of Ray blocks SIGINT, and a blocked signal stays blocked in children.
            signal.pthread_sigmask(signal.SIG_SETMASK, ())
            _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
            if os.getppid() != parent:  # it died before prctl
                os._exit(1)
            if nice:
                os.nice(nice)
            if cores:
                os.sched_setaffinity(0, cores)

        with out.open("ab") as file:
            self._process = subprocess.Popen(
                self.command,
                stdin=None if terminal else subprocess.DEVNULL,
                stdout=None if terminal else file,
                stderr=file,
                start_new_session=not terminal,
                cwd=ROOT,  # scenarios name models relative to the tree
                preexec_fn=in_child,
                env={**os.environ, **(environment or {})},
            )

    @property
    def pid(self) -> int:
        return self._process.pid

    def poll(self) -> int | None:
        """Exit code (negative: killed by that signal), None while it runs."""
        return self._process.poll()

    def send(self, signal_number: int) -> None:
        """To the whole group, so that a program started through a shell or a wrapper hears it too."""
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                (os.killpg if self._grouped else os.kill)(self.pid, signal_number)

    def stop(self, patience_s: float) -> int:
        """SIGTERM, then after `patience_s` SIGKILL. Returns the exit code."""
        self.send(signal.SIGTERM)
        return self.wait(patience_s)

    def wait(self, patience_s: float) -> int:
        """Waits for its end; SIGKILL after `patience_s`."""
        deadline = time.monotonic() + patience_s
        while (code := self.poll()) is None:
            if time.monotonic() > deadline:
                self.send(signal.SIGKILL)
                return self._process.wait()
            time.sleep(0.02)
        return code

    def last_lines(self, n: int = 6) -> list[str]:
        """The last lines that it wrote since this start."""
        try:
            with self.out.open("rb") as file:
                file.seek(max(self._out_start, file.seek(0, os.SEEK_END) - 8192))
                text = file.read().decode("utf-8", "replace")
        except OSError:
            return []
        return [line.rstrip() for line in text.splitlines() if line.strip()][-n:]

    def death(self) -> str:
        """A sentence with its name, exit code and last lines."""
        how = ending(self.poll())
        lines = self.last_lines()
        said = (
            " Its last lines:\n" + "\n".join("  " + line for line in lines) if lines else " It wrote nothing."
        )
        return f"The {self.name} {how}.{said}\nAll of its output: {self.out}"


def ending(code: int | None) -> str:
    """How a program ended, as the rest of a sentence."""
    if code is not None and code < 0:
        return f"was killed by {signal.Signals(-code).name}"
    return f"ended with exit code {code}"


@contextlib.contextmanager
def interruptible() -> Iterator[Callable[[], int]]:
    """Counts SIGINT, SIGTERM and SIGHUP instead of dying of them; gives the counter."""
    count = 0

    def handler(_signal: int, _frame: Any) -> None:
        nonlocal count
        count += 1

    old = {
        number: signal.signal(number, handler) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    }
    try:
        yield lambda: count
    finally:
        for number, previous in old.items():
            signal.signal(number, previous)


def missing_program(command: Command) -> str | None:
    """A sentence when a command's program is not there."""
    first = Path(str(command[0]))
    if os.access(first, os.X_OK):
        return None
    return (
        f"{first} is not built; run ./tandem doctor once, it builds what is missing, or see .setup/build.log."
    )


def learner_command() -> list[str]:
    """The learner's program, or what stands in for it."""
    if stand_in := os.environ.get(LEARNER_STAND_IN):
        return shlex.split(stand_in)
    return [sys.executable, "-m", "tandem.learner"]
