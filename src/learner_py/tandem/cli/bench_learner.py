"""`tandem bench learner`: gradient updates a second on one core, beside PyTorch eager and the core's limit."""

import os
import shutil
import statistics
import sys
import tempfile
from pathlib import Path
from typing import Annotated, Any

import typer

from tandem.cli.common import JsonOption, SetOption, fail, sentences, write_json

BLOCK = 100  # updates of one contender in one round
LOSS_TOLERANCE = 1e-5  # relative, between the contenders' losses on one minibatch


def learner(
    rounds: Annotated[int, typer.Option(help="Turns that both take.", min=1, max=1000)] = 9,
    core: Annotated[int, typer.Option(help="Core for both [default: the last that we may use].")] = -1,
    torch_python: Annotated[
        str, typer.Option("--torch-python", metavar="PYTHON", help="A Python that has torch.")
    ] = "/usr/bin/python3",
    overrides: SetOption = None,
    json_file: JsonOption = None,
) -> None:
    """Gradient updates a second of the recipe `tandem` (flow h 4, five critics 2 x 128, batch 256), one thread: ours
    (JAX, jitted) and the same update in PyTorch eager, float32 both, in turns on one core.

    Both start from the same parameters; their losses on one minibatch are compared first, beyond 1e-5 the command
    fails. limit: the matrix products of an update alone, at the rate that this core reaches in registers.
    JSON: updates_per_s and torch_updates_per_s (medians), ratio, limit_updates_per_s, flops, gflops, rounds, host.
    """
    from tandem import run_folder, scenario
    from tandem.learner import xla
    from tandem.loop_bench import LoopBenchError, cores
    from tandem.policy_bench.contenders import Contender, PolicyBenchError, Running, machine_limits

    xla.configure()  # before anything imports JAX
    from tandem.learner.config import load_scenario
    from tandem.learner_bench import work

    try:
        core, _ = cores(core)
    except LoopBenchError as error:
        fail(str(error), 2)
    if shutil.which(torch_python) is None:
        fail(f"--torch-python is {torch_python}; there is no such program.", 2)
    with sentences(), tempfile.TemporaryDirectory(prefix="tandem-bench-") as name:
        file, given = Path(name) / "scenario.yaml", Path(name) / "work.npz"
        setting = scenario.compose(run_folder.CONFIG, "peg", "tandem", {"mode": "train"}, overrides or [])
        setting.write(file)
        read = load_scenario(file)
        try:
            work.write(given, read)
            ours = Contender("Tandem", "jax", [sys.executable, "-m", "tandem.learner_bench.ours", file])
            peer = Contender(
                "PyTorch", "torch", [torch_python, run_folder.ROOT / "bench/learner/torch_update.py"]
            )
            with Running(ours, given, core) as first, Running(peer, given, core) as second:
                _compare(first.ask("losses", 0), second.ask("losses", 0))
                turns = []
                for turn in range(rounds):
                    both = [first, second] if turn % 2 == 0 else [second, first]
                    us = {each: each.ask("run", BLOCK)[0] for each in both}
                    turns.append({"updates_per_s": 1e6 / us[first], "torch_updates_per_s": 1e6 / us[second]})
                version = second.about["version"]
            gflops = machine_limits([1 << 16], core)["gflops"]
        except (work.WorkError, PolicyBenchError) as error:
            hint = "; as root: apt-get install python3-torch." if "torch" in str(error) else ""
            fail(f"{error}{hint}")
    value = report(turns, work.flops(read), gflops) | {
        "torch": version,
        "core": core,
        "load_average": os.getloadavg()[0],
        "git_revision": run_folder.git_revision(),
        "host": run_folder.host(),
    }
    print(
        f"learner: {value['updates_per_s']:.0f} updates/s; PyTorch {version} eager"
        f" {value['torch_updates_per_s']:.0f}: {value['ratio']:.2f} x;"
        f" limit {value['limit_updates_per_s']:.0f} ({value['flops'] / 1e6:.0f} MFLOP at {gflops:.0f} GFLOP/s)"
        f" (medians of {rounds} rounds on core {core})"
    )
    if value["load_average"] > 1.5:
        print(
            f"The machine is busy (load {value['load_average']:.1f}); on an idle one the figures are higher."
        )
    write_json(json_file, value)


def report(turns: list[dict[str, float]], flops: int, gflops: float) -> dict[str, Any]:
    """Medians; the ratio is of each round's pair."""
    return {
        "updates_per_s": statistics.median(turn["updates_per_s"] for turn in turns),
        "torch_updates_per_s": statistics.median(turn["torch_updates_per_s"] for turn in turns),
        "ratio": statistics.median(turn["updates_per_s"] / turn["torch_updates_per_s"] for turn in turns),
        "limit_updates_per_s": gflops * 1e9 / flops,
        "flops": flops,
        "gflops": gflops,
        "rounds": turns,
    }


def _compare(ours: list[float], peer: list[float]) -> None:
    for name, one, other in zip(("critic", "actor"), ours, peer, strict=True):
        if not abs(one - other) <= LOSS_TOLERANCE * abs(other):
            fail(
                f"The {name}'s loss is {one:.7g} here and {other:.7g} in PyTorch; the two do not do the same work."
            )
