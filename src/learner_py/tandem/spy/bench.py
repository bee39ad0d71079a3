"""What `tandem bench spy` measures: the real command in a terminal of its own, and a program that keeps LCM busy.

The generator publishes so many channels at so many Hz, each message with a number; the terminal is a pseudo one whose
output is read and thrown away. CPU share is what the operating system booked for spy's process, user and system.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import pty
import select
import signal
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tandem.processes import Child

START_S = 4.0  # spy's imports and first screen, not measured
END_S = 30.0  # for what waits in LCM's queue after the generator's end, on a machine that is busy with other things
IDLE_SHARE = 0.06  # of a core: spy without messages needs less
BENCH_PREFIX = "BENCH_"  # of its channels
TARGET_CPU_SHARE = 0.25  # of one core, at 10 channels at 1 kHz


class SpyBenchError(Exception):
    """A sentence: what could not be measured and why."""


@dataclass(frozen=True)
class Load:
    """What is published."""

    channels: int
    hz: int
    seconds: float

    @property
    def messages(self) -> int:
        return self.channels * int(self.hz * self.seconds)


def prototypes() -> dict[str, tuple[bytearray, dict[str, int]]]:
    """Encoded messages of numbered types, and where utime and the number lie."""
    from tandem_lcm.tandem.action_chunk_t import action_chunk_t
    from tandem_lcm.tandem.control_tick_t import control_tick_t
    from tandem_lcm.tandem.robot_state_t import robot_state_t
    from tandem_lcm.tandem.world_state_t import world_state_t

    from tandem.spy.layout import FINGERPRINT_BYTES, of_fingerprint

    found = {}
    chunk = action_chunk_t()
    chunk.horizon = 4
    chunk.policy_chunk = [[0.1] * 7] * 4
    for message in (robot_state_t(), control_tick_t(), world_state_t(), chunk):
        data = bytearray(message.encode())
        layout = of_fingerprint(bytes(data[:FINGERPRINT_BYTES]))
        assert layout is not None and layout.sequence is not None
        offsets = {"utime": layout.members["utime"][0], "number": layout.members[layout.sequence.member][0]}
        found[layout.name] = (data, offsets)
    return found


def generate(url: str, load: Load) -> dict[str, Any]:
    """Publishes at an even pace; a late moment is made up for, nothing is left out."""
    import lcm

    link = lcm.LCM(url)
    # a mixture as of a run: most of it the arm's state, a type of variable size among them
    order = ("robot_state_t", "control_tick_t", "robot_state_t", "world_state_t", "action_chunk_t")
    made = prototypes()
    channels = []
    for i in range(load.channels):
        name = order[i % len(order)]
        data, offsets = made[name]
        code = ">i" if name in ("world_state_t", "action_chunk_t") else ">q"
        channels.append((f"{BENCH_PREFIX}{i}_{name[:-2].upper()}", data, offsets, code))
    ticks = int(load.hz * load.seconds)
    period_ns = 1_000_000_000 // load.hz
    begin, late = time.monotonic_ns(), 0
    for tick in range(ticks):
        wait = begin + tick * period_ns - time.monotonic_ns()
        if wait > 0:
            time.sleep(wait / 1e9)
        late = max(late, -wait)
        for channel, data, offsets, code in channels:
            struct.pack_into(">q", data, offsets["utime"], time.monotonic_ns() // 1000)
            struct.pack_into(code, data, offsets["number"], tick)
            link.publish(channel, bytes(data))
    return {
        "messages": ticks * load.channels,
        "seconds": (time.monotonic_ns() - begin) / 1e9,
        "cpu_share": time.process_time() * 1e9 / (time.monotonic_ns() - begin),
        "late_max_ms": late / 1e6,
    }


def measure(folder: Path, url: str, load: Load, page: str, size: tuple[int, int]) -> dict[str, Any]:
    """Spy on one page while the generator runs."""
    told = folder / f"spy-{page}.json"
    command = [sys.executable, "-m", "tandem", "spy", "--lcm", url, "--json", str(told)]
    with terminal(command, size) as (process, type_):
        _wait(process, START_S)
        before = cpu_s(process.pid)
        generator = program("generator", folder, "generate", url, load.channels, load.hz, load.seconds)
        try:
            _wait(process, 1.0)
            for key in {"channels": "1", "fields": "1\r", "robot": "3", "learning": "4"}[page]:
                type_(key)
                _wait(process, 0.3)
            if generator.wait(load.seconds + 60.0) != 0:
                raise SpyBenchError(generator.death())
        finally:
            generator.stop(1.0)
        # all that these messages cost, whenever it was done (on a busy machine spy lags behind), without the
        # picture's share after the generator's end
        ended = time.monotonic()
        idle = _until_idle(process)
        used = cpu_s(process.pid) - before - idle * (time.monotonic() - ended)
        type_("q")
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(10.0)
    if process.returncode != 0 or not told.exists():
        raise SpyBenchError(f"spy ended with exit code {process.returncode} and left no figures.")
    return {
        "page": page,
        "cpu_share": used / load.seconds,
        **_received(json.loads(told.read_text()), load),
        "generator": json.loads(generator.last_lines(1)[0]),
    }


def measure_reader(folder: Path, url: str, load: Load) -> float:
    """CPU share of the least that a Python program can do: the lcm package hands over every message, nothing else."""
    reader = program("reader", folder, "read", url)
    generator = program("generator", folder, "generate", url, load.channels, load.hz, load.seconds)
    try:
        time.sleep(1.5)
        before, began = cpu_s(reader.pid), time.monotonic()
        time.sleep(max(1.0, load.seconds - 3.0))
        share = (cpu_s(reader.pid) - before) / (time.monotonic() - began)
        if generator.wait(30.0) != 0:
            raise SpyBenchError(generator.death())
        return share
    finally:
        generator.stop(1.0)
        reader.stop(1.0)


def read_only(url: str) -> None:
    """Until it is stopped."""
    import lcm

    link = lcm.LCM(url)
    link.subscribe(".*", lambda channel, data: None).set_queue_capacity(0)
    while True:
        link.handle_timeout(1000)


def program(name: str, folder: Path, *words: str | float) -> Child:
    """This file in a process of its own: `generate URL CHANNELS HZ SECONDS` or `read URL`."""
    command = [sys.executable, "-m", "tandem.spy.bench", *map(str, words)]
    return Child(name, command, folder / f"{name}.out")


def _received(told: dict[str, Any], load: Load) -> dict[str, Any]:
    """What spy itself counted, against what was sent."""
    ours = [row for row in told["channels"] if row["channel"].startswith(BENCH_PREFIX)]
    latencies = [row["latency_ms"] for row in ours if row["latency_ms"]]
    received = sum(row["count"] for row in ours)
    return {
        "sent": load.messages,
        "received": received,
        "lost": load.messages - received,
        "gaps": sum(row["gaps"] or 0 for row in ours),
        "undecodable": sum(row["undecodable"] for row in ours),
        "latency_ms": {key: max(row[key] for row in latencies) for key in ("p50", "p99", "max")}
        if latencies
        else None,
    }


def cpu_s(pid: int) -> float:
    """User and system time of a process and all its threads so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextlib.contextmanager
def terminal(command: list[str], size: tuple[int, int]) -> Iterator[tuple[subprocess.Popen[bytes], Any]]:
    """A program in a pseudo terminal of (columns, rows) whose output is thrown away; gives it and `type(text)`."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", size[1], size[0], 0, 0))
    environment = {**os.environ, "TERM": "xterm-256color", "COLUMNS": str(size[0]), "LINES": str(size[1])}
    process = subprocess.Popen(
        command, stdin=theirs, stdout=theirs, stderr=theirs, env=environment, start_new_session=True
    )
    os.close(theirs)
    ended = threading.Event()

    def drain() -> None:
        while not ended.is_set():
            if select.select([ours], [], [], 0.1)[0]:
                with contextlib.suppress(OSError):
                    if os.read(ours, 1 << 16):
                        continue
                return

    reader = threading.Thread(target=drain, daemon=True)
    reader.start()
    try:
        yield process, lambda text: os.write(ours, text.encode())
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGKILL)
            process.wait()
        ended.set()
        reader.join()
        os.close(ours)


def _until_idle(process: subprocess.Popen[bytes]) -> float:
    """Until everything that was sent is taken in. Returns the CPU share of spy without messages."""
    deadline = time.monotonic() + END_S
    _wait(process, 1.0)
    share = 1.0
    while share > IDLE_SHARE and time.monotonic() < deadline:
        before, began = cpu_s(process.pid), time.monotonic()
        _wait(process, 2.0)
        share = (cpu_s(process.pid) - before) / (time.monotonic() - began)
    return share


def _wait(process: subprocess.Popen[bytes], seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if process.poll() is not None:
            raise SpyBenchError(
                f"spy ended early, with exit code {process.returncode}; try ./tandem spy --once."
            )
        time.sleep(0.05)


if __name__ == "__main__":
    if sys.argv[1] == "read":
        read_only(sys.argv[2])
    else:
        load_ = Load(int(sys.argv[3]), int(sys.argv[4]), float(sys.argv[5]))
        print(json.dumps(generate(sys.argv[2], load_)))
