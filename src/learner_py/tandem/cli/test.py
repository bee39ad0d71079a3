"""`tandem test [--sanitizer thread|address] [--target NAME] [--fuzz N] [CTEST OPTIONS]`."""

import enum
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer

from tandem.cli.common import fail
from tandem.run_folder import ROOT

# clang and its fuzzer, as scripts/debian-packages.txt has them
CLANG = {"CMAKE_C_COMPILER": "clang-14", "CMAKE_CXX_COMPILER": "clang++-14"}
FUZZED = (
    "TELEOP_COMMAND",
    "IMPEDANCE_GAINS",
    "CONTROLLER_COMMAND",
    "POLICY_ANNOUNCE",
    "EPISODE_ACK",
    "EPISODE_REQUEST",
    "LEARNER_STATUS",
    "POLICY_FILE",
)
LARGEST_INPUT = {"POLICY_FILE": 65536}  # bytes; a valid input has fewer
LARGEST_MESSAGE = 4096


class Sanitizer(enum.StrEnum):
    thread = "thread"
    address = "address"


def test(
    context: typer.Context,
    sanitizer: Annotated[
        Sanitizer | None,
        typer.Option(
            help="In a tree of its own: build-thread (data races), build-address (memory errors, undefined behaviour)."
        ),
    ] = None,
    target: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Build only this C++ test program and run its tests; repeatable, e.g. law_test.",
        ),
    ] = None,
    fuzz: Annotated[
        int,
        typer.Option(
            metavar="N",
            min=0,
            help="Instead of the tests: N inputs to each fuzz target, in build-fuzz. The same N gives the same inputs.",
        ),
    ] = 0,
) -> None:
    """Build everything and run all tests (C++ and Python) under ctest.

    What follows is handed to ctest: -R REGEX runs tests by name, -L LABEL by label, -N lists them. With --fuzz it names
    targets (default: all).
    """
    if fuzz:
        raise typer.Exit(_fuzz(fuzz, context.args))
    tree = ROOT / "build" if sanitizer is None else _configure(sanitizer.value)
    targets = target or []
    _build(tree, *targets)
    command = ["ctest", "--test-dir", str(tree), "--output-on-failure", *context.args]
    if targets:
        command += ["-L", f"^({'|'.join(targets)})$"]
    if sanitizer is None:
        raise typer.Exit(subprocess.run(command, cwd=ROOT).returncode)
    reports = tree / "reports"
    shutil.rmtree(reports, ignore_errors=True)
    reports.mkdir()
    # Without address randomisation: gcc's thread sanitizer can't place its shadow memory in every layout.
    command = ["setarch", platform.machine(), "--addr-no-randomize", *command]
    code = subprocess.run(command, cwd=ROOT, env={**os.environ, **options(sanitizer, reports)}).returncode
    raise typer.Exit(_tell(reports) or code)


def options(sanitizer: Sanitizer, reports: Path) -> dict[str, str]:
    """Environment of instrumented programs. Reports go to files: many programs here run below others."""
    suppressions = ROOT / "tests" / "sanitizers"
    common = f"log_path={reports}/report:halt_on_error=0"
    if sanitizer is Sanitizer.thread:
        return {
            "LDFLAGS": "-fsanitize=thread",  # of what a test builds against our libraries
            "TSAN_OPTIONS": f"{common}:suppressions={suppressions}/thread.supp:second_deadlock_stack=1",
        }
    return {
        "LDFLAGS": "-fsanitize=address,undefined",
        "ASAN_OPTIONS": f"{common}:detect_stack_use_after_return=1:strict_string_checks=1",
        "UBSAN_OPTIONS": f"{common}:print_stacktrace=1",
        "LSAN_OPTIONS": f"suppressions={suppressions}/leak.supp:print_suppressions=0",
    }


def _tell(reports: Path) -> int:
    """Prints what the sanitizers found. Returns 1 when they found something."""
    found = sorted(file for file in reports.iterdir() if file.stat().st_size)
    for file in found:
        print(f"==== {file.name}\n{file.read_text(errors='replace')}", file=sys.stderr)
    if found:
        print(f"tandem: {len(found)} programs were found at fault; see {reports}.", file=sys.stderr)
    return 1 if found else 0


def _fuzz(n: int, names: list[str]) -> int:
    for name in names:
        if name not in FUZZED:
            fail(f"'{name}' is no fuzz target; there are {', '.join(FUZZED)}.", 2)
    if missing := [name for name in CLANG.values() if shutil.which(name) is None]:
        fail(f"{missing[0]} is missing; as root: apt-get install clang-14 libclang-rt-14-dev.")
    tree = _configure("fuzz")
    _build(tree, "tandem_fuzz")
    for name in names or FUZZED:
        artifacts = tree / "found" / name
        artifacts.mkdir(parents=True, exist_ok=True)
        command = [
            str(tree / "bin" / "tandem_fuzz"),
            f"--target={name}",
            f"-runs={n}",
            "-seed=1",
            f"-max_len={LARGEST_INPUT.get(name, LARGEST_MESSAGE)}",
            "-len_control=0",
            "-rss_limit_mb=4096",
            "-timeout=60",
            "-verbosity=0",
            f"-artifact_prefix={artifacts}/",
        ]
        if code := subprocess.run(command, cwd=ROOT).returncode:
            print(
                f"tandem: {name} failed; the input lies in {artifacts}. Once more:\n  {' '.join(command)}",
                file=sys.stderr,
            )
            return code
    return 0


def _configure(kind: str) -> Path:
    """The build tree build-KIND, configured."""
    tree = ROOT / f"build-{kind}"
    values = {
        "CMAKE_BUILD_TYPE": "Release",
        "CMAKE_CXX_COMPILER_LAUNCHER": "ccache",
        "CMAKE_C_COMPILER_LAUNCHER": "ccache",
        "TANDEM_SANITIZE": kind,
        "TANDEM_VENV": sys.prefix,
        **(CLANG if kind == "fuzz" else {}),
    }
    command = ["cmake", "-S", str(ROOT), "-B", str(tree), "-G", "Ninja"]
    command += [f"-D{name}={value}" for name, value in values.items()]
    done = subprocess.run(command, cwd=ROOT, capture_output=(tree / "build.ninja").exists(), text=True)
    if done.returncode:
        fail(f"{tree.name} could not be configured: {done.stderr or 'see above'}")
    return tree


def _build(tree: Path, *targets: str) -> None:
    command = ["cmake", "--build", str(tree), *(["--target", *targets] if targets else [])]
    if code := subprocess.run(command, cwd=ROOT).returncode:
        raise typer.Exit(code)
