"""What `tandem bench loop` runs: a learner that trains all the while on one core, and on another, in turns, the
controller in real time and cyclictest with the same priority.

    prepare      twenty demonstrations of the scripted operator; from them a first policy
    learner      trains on the demonstrations until it is stopped, pinned to the other cores
    slice        the controller drives the policy, then cyclictest sleeps and wakes, each so many seconds

The learner is the real one, with so many warm-start updates that it never comes to their end.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tandem import processes
from tandem.evaluation import Evaluation
from tandem.histogram import Histogram, added
from tandem.processes import Child, Command
from tandem.run_folder import program
from tandem.scenario import Scenario

DEMONSTRATIONS = 20
SEED = 5_000_000  # of the operator's and the controller's episodes here
EPISODE_STEPS = 50  # 5 s: a slice sees episodes begin and end
ENDLESS_UPDATES = 1_000_000  # the most that a scenario may ask for; hours of training
PREPARE_LIMIT_S = 300.0
CYCLICTEST_RANGE_US = 100_000
TARGETS = {"tick_compute_p99_us": 50.0, "wakeup_p999_ratio": 1.5, "allocations": 0}


class LoopBenchError(Exception):
    """A sentence: what could not be measured and why."""


@dataclass
class Slice:
    """One turn of the controller and one of cyclictest."""

    controller: dict[str, Any]  # its results
    cyclictest: dict[str, Any]  # its JSON


def cores(wanted: int) -> tuple[int, list[int]]:
    """The core to measure on (default: the last that we may use) and those for the learner."""
    allowed = sorted(os.sched_getaffinity(0))
    core = allowed[-1] if wanted < 0 else wanted
    if core not in allowed:
        raise LoopBenchError(f"--core is {core}; this process may use {allowed}.")
    return core, [other for other in allowed if other != core] or [core]


def cyclictest() -> Path:
    found = shutil.which("cyclictest") or shutil.which("cyclictest", path="/usr/sbin:/usr/bin")
    if found is None:
        raise LoopBenchError("cyclictest is missing; as root: apt-get install rt-tests.")
    return Path(found)


def priority(scenario: Scenario) -> int:
    """SCHED_FIFO priority of the control thread."""
    return int(scenario.data["controller"].get("realtime", {}).get("priority", 80))


def _learning(scenario: Scenario, demonstrations: int, warm_start_updates: int) -> Scenario:
    method = scenario.data["method"]
    learner = {**method["learner"], "warm_start_updates": warm_start_updates}
    changed = scenario.copy_with(mode="train", clock="realtime", demonstrations=demonstrations)
    changed.data["method"] = {**method, "learner": learner}
    return changed


def _start_learner(folder: Path, log: Path, scenario: Scenario, on: list[int]) -> Child:
    folder.mkdir(parents=True)
    shutil.copyfile(log, folder / "log.lcm")
    scenario.write(folder / "scenario.yaml")
    command: Command = [
        "taskset", "--cpu-list", ",".join(map(str, on)), *processes.learner_command(),
        "--scenario", folder / "scenario.yaml", "--run", folder, "--lcm-url", processes.free_lcm_url(),
    ]  # fmt: skip
    return Child("learner", command, folder / "learner.out")


def _wait(child: Child, done: Callable[[], bool], doing: str) -> None:
    deadline = time.monotonic() + PREPARE_LIMIT_S
    while not done():
        if child.poll() is not None:
            raise LoopBenchError(child.death())
        if time.monotonic() > deadline:
            raise LoopBenchError(f"{doing} took longer than {PREPARE_LIMIT_S:.0f} s; see {child.out}.")
        time.sleep(0.1)


@dataclass
class Prepared:
    log: Path  # of the demonstrations
    policy: Path
    demonstrations: int


def prepare(folder: Path, scenario: Scenario, on: list[int]) -> Prepared:
    """Demonstrations and a first policy, below `folder`."""
    shown = folder / "demonstrations"
    result = Evaluation("demonstrations", scenario, None, SEED, DEMONSTRATIONS, shown).run()
    good = int(result["successes"])
    if good == 0:
        raise LoopBenchError(f"the operator succeeded in none of {DEMONSTRATIONS} episodes; see {shown}.")
    first = folder / "first-policy"
    learner = _start_learner(first, shown / "log.lcm", _learning(scenario, good, 64), on)
    policy = first / "policies" / "policy_000001.safetensors"
    try:
        _wait(learner, policy.exists, "making a first policy")
    finally:
        learner.stop(10.0)
    return Prepared(shown / "log.lcm", policy, good)


@contextmanager
def training(
    folder: Path, scenario: Scenario, prepared: Prepared, on: list[int]
) -> Iterator[Callable[[], int]]:
    """A learner at work; gives a function that tells its updates so far."""
    from tandem_lcm.tandem.learner_status_t import learner_status_t

    from tandem.wire import Wire

    endless = _learning(scenario, prepared.demonstrations, ENDLESS_UPDATES)
    learner = _start_learner(folder / "learner", prepared.log, endless, on)
    updates = 0

    def hear(status: Any, _data: bytes) -> None:
        nonlocal updates
        updates = max(updates, status.updates_done)

    wire = Wire(str(learner.command[-1]))
    wire.subscribe(learner_status_t, hear)

    def done() -> int:
        if learner.poll() is not None:
            raise LoopBenchError(learner.death())
        wire.handle(0.0)
        return updates

    try:
        _wait(learner, lambda: done() > 0, "the learner's start")
        yield done
    finally:
        learner.stop(10.0)


def controller_slice(
    folder: Path, scenario: Scenario, policy: Path, seconds: float, core: int
) -> dict[str, Any]:
    """The controller in real time for so long. Returns its results."""
    driving = scenario.copy_with(
        mode="evaluate",
        clock="realtime",
        seed=SEED,
        episodes=1_000_000,  # until it is stopped
        policy=str(policy),
    )
    driving.data["task"] = {**driving.data["task"], "max_steps": EPISODE_STEPS}
    driving.write(folder / "scenario.yaml")
    results = folder / "results.json"
    command: Command = [
        "taskset", "--cpu-list", str(core), program("tandem_controller"),
        "--scenario", folder / "scenario.yaml", "--run", folder, "--results", results, "--lcm-url", "memq://",
    ]  # fmt: skip
    counter = program("libtandem_allocations.so")
    preload = {"LD_PRELOAD": str(counter)} if counter.exists() else {}
    controller = Child("controller", command, folder / "controller.out", environment=preload)
    try:
        log = folder / "log.lcm"
        _wait(controller, lambda: log.exists() and log.stat().st_size > 50_000, "the controller's start")
        time.sleep(seconds)
        if controller.poll() is not None:
            raise LoopBenchError(driving.explain(controller.death()))
    finally:
        code = controller.stop(30.0)
    if code not in processes.STOPPED:
        raise LoopBenchError(driving.explain(controller.death()))
    value = json.loads(results.read_text())
    log.unlink()  # a run keeps nothing but its figures
    return value


def cyclictest_slice(folder: Path, seconds: float, core: int, at: int) -> dict[str, Any]:
    """cyclictest as the control thread sleeps: absolute deadlines 1 ms apart, SCHED_FIFO, memory locked."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "cyclictest.json"
    command: Command = [
        cyclictest(), "--quiet", "--mlockall", "--threads=1", f"--affinity={core}", f"--priority={at}",
        "--interval=1000", f"--duration={max(1, round(seconds))}", f"--histogram={CYCLICTEST_RANGE_US}",
        f"--json={file}",
    ]  # fmt: skip
    child = Child("cyclictest", command, folder / "cyclictest.out")
    if child.wait(seconds + 30.0) != 0 or not file.exists():
        raise LoopBenchError(
            f"{child.death()}\nIt needs the right to real-time priority {at}: run as root, or allow 'rtprio' and "
            "'memlock' in /etc/security/limits.conf."
        )
    return json.loads(file.read_text())


def histograms(slices: list[Slice]) -> dict[str, Histogram]:
    """Over all slices: tick_compute_us, wakeup_us, cyclictest_us."""
    try:
        return {
            "tick_compute_us": added(
                Histogram.of_controller(s.controller["tick_compute_histogram_us"]) for s in slices
            ),
            "wakeup_us": added(Histogram.of_controller(s.controller["wakeup_histogram_us"]) for s in slices),
            "cyclictest_us": added(Histogram.of_cyclictest(s.cyclictest) for s in slices),
        }
    except KeyError as error:
        raise LoopBenchError(f"the controller's results lack {error}; build it again.") from None


def report(slices: list[Slice]) -> dict[str, Any]:
    """The figures under the names that other tools read; allocations None when they were not counted."""
    found = {name: histogram.percentiles() for name, histogram in histograms(slices).items()}
    counted: list[int | None] = [s.controller.get("allocations") for s in slices]
    ratio = found["wakeup_us"]["p999"] / max(found["cyclictest_us"]["p999"], 1e-9)
    allocations = None if None in counted else sum(n for n in counted if n is not None)
    return {
        "ticks": sum(s.controller["ticks"] for s in slices),
        "overruns": sum(s.controller["overruns"] for s in slices),
        "allocations": allocations,
        **found,
        "wakeup_p999_ratio": ratio,
        "targets": TARGETS,
        "reached": {
            "tick_compute_p99_us": found["tick_compute_us"]["p99"] <= TARGETS["tick_compute_p99_us"],
            "wakeup_p999_ratio": ratio <= TARGETS["wakeup_p999_ratio"],
            "allocations": allocations == TARGETS["allocations"],
        },
        "slices": [
            {name: h.percentiles() for name, h in histograms([s]).items()}
            | {"ticks": s.controller["ticks"], "overruns": s.controller["overruns"]}
            for s in slices
        ],
    }
