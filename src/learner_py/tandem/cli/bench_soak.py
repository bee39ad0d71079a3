"""`tandem bench soak`."""

from pathlib import Path
from typing import Annotated

import typer

from tandem.cli.common import JsonOption, fail, sentences, write_json


def soak(
    minutes: Annotated[
        float, typer.Option(help="Minutes of motion during which things go wrong.", min=0.1, max=10_000.0)
    ] = 30.0,
    seed: Annotated[int, typer.Option(help="Of the training and of the monkey, 0 to 999999.", min=0)] = 0,
    run: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Run folder [default: runs/soak-seedN].")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Train in real time while faults, kills, bad policies and senseless messages come at random.

    Then asks the log: torque limits held on every tick, every fault ended in a declared state, every completed
    episode reached the learner once. Exit code 1 and a sentence when an answer is no.
    """
    from rich.console import Console
    from rich.table import Table

    from tandem import run_folder
    from tandem.run_folder import RunFolder
    from tandem.soak.run import soak as do_soak
    from tandem.soak.verdict import counters, judge

    console = Console()
    folder = RunFolder((run or run_folder.RUNS / f"soak-seed{seed}").absolute())
    with sentences():
        lock = folder.lock()
        try:
            if folder.path.exists() and any(folder.path.iterdir()):
                console.print(f"The old run is kept as {run_folder.shown(folder.set_aside())}.")
            soaked = do_soak(folder, seed, 60.0 * minutes, lambda line: print(line, flush=True))
            print("Reading the log.", flush=True)
            checks = judge(folder, soaked)
        except OSError as error:
            fail(f"{error}")
        finally:
            lock.close()

    table = Table("", "check", "", title=f"{soaked.seconds / 60:.1f} minutes, seed {seed}")
    for check in checks:
        table.add_row("ok" if check.passed else "FAILED", check.name, check.sentence)
    console.print(table)
    done = Table("deed", "times", title="What went wrong on purpose")
    for name, n in sorted(soaked.monkey.done.items()):
        done.add_row(name, str(n))
    for text, n in checks[2].figures.get("faults", {}).items():
        done.add_row(f"fault: {text}", str(n))
    console.print(done)
    failed = [check for check in checks if not check.passed]
    write_json(
        json_file,
        {
            "passed": not failed,
            "minutes": soaked.seconds / 60,
            "seed": seed,
            "checks": {c.name: {"passed": c.passed, "sentence": c.sentence, **c.figures} for c in checks},
            "deeds": dict(sorted(soaked.monkey.done.items())),
            "counters": counters(soaked),
            "grades": dict(soaked.ear.grades),
            "policy_refusals": dict(soaked.ear.refusals),
            "git_revision": run_folder.git_revision(),
            "host": run_folder.host(),
        },
    )
    if failed:
        fail(
            " ".join(f"{check.name}: NO, {check.sentence}." for check in failed)
            + f" Log and outputs: {run_folder.shown(folder.path)}"
        )
