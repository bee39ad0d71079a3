"""`tandem bench policy`: how long a policy takes in our runtime, beside other engines in the same run."""

import os
import tempfile
from pathlib import Path
from typing import Annotated, Any

import typer

from tandem.cli.common import JsonOption, fail, sentences, write_json


def policy(
    policies: Annotated[
        list[str] | None,
        typer.Option("--policy", metavar="NAME", help="Only this one; repeatable [default: all eight]."),
    ] = None,
    rounds: Annotated[int, typer.Option(help="Turns that the contenders take.", min=1, max=1000)] = 20,
    core: Annotated[int, typer.Option(help="Core for everyone [default: the last that we may use].")] = -1,
    json_file: JsonOption = None,
    plot_file: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="Draw p50 and p99 of everyone to FILE.")
    ] = None,
) -> None:
    """Time of one evaluation (batch 1, one thread, float32, us) of random policies: ours with every kernel that this
    machine runs, ONNX Runtime, OpenVINO, XLA (JAX, jitted) and plain Eigen, in turns on one core.

    net: without what a call from Python costs, measured by a graph that computes nothing; the ratio to the better of
    ONNX Runtime and OpenVINO is of net times. limit: reading the weights or the arithmetic at the rates that this core
    reaches, whichever takes longer. error: against JAX, in action units; beyond 1e-4 the command fails. A target
    that is missed is said, and does not fail it. All policies take about ten minutes. JSON: policies (limit_us, ratio,
    target, reached, contenders with p50_us, p99_us, max_us, net_p50_us, parity_error, ...), rounds, core, host.
    """
    from tandem.learner import xla
    from tandem.loop_bench import LoopBenchError, cores

    xla.configure()  # before anything imports JAX
    from tandem import run_folder
    from tandem.policy_bench import POLICIES, contenders, cost, measure, report, weights

    known = {each.name: each for each in POLICIES}
    if unknown := sorted(set(policies or ()) - set(known)):
        fail(f"--policy {unknown[0]} is none of {', '.join(known)}.", 2)
    chosen = [each for each in POLICIES if not policies or each.name in policies]
    try:
        core, _ = cores(core)
    except LoopBenchError as error:
        fail(str(error), 2)

    done: list[dict[str, Any]] = []
    with sentences(), tempfile.TemporaryDirectory(prefix="tandem-bench-") as name:
        for each in chosen:
            file = Path(name) / f"{each.name}.safetensors"
            try:
                weights.write(file, each)
                takes = cost.of(each)
                everyone = contenders.field_of(takes.flops)
                found, limits = measure.measure(file, everyone, takes, rounds, core)
            except contenders.PolicyBenchError as error:
                fail(str(error))
            file.unlink()
            done.append(report.figures(each, takes, found, limits))
            show(done[-1])
    show_targets(done)
    load = os.getloadavg()[0]
    value = {
        "policies": done,
        "rounds": rounds,
        "core": core,
        "load_average": load,
        "git_revision": run_folder.git_revision(),
        "host": run_folder.host(),
    }
    if load > 2.0:
        print(f"The machine is busy (load {load:.1f}); measure it idle.")
    write_json(json_file, value)
    if plot_file is not None:
        draw(plot_file, done)
    if phrases := report.wrong(done):
        fail("; ".join(phrases) + ".")


def show(value: dict[str, Any]) -> None:
    """One policy."""
    from rich.console import Console
    from rich.table import Table

    print(f"\n{value['policy']}: {value['description']}")
    print(
        f"{value['weights_bytes'] / 1e6:.2f} MB of weights, {value['flops'] / 1e6:.2f} MFLOP; this core's limit is"
        f" {_number(value['limit_us'])} us ({value['gbytes_per_s']:.0f} GB/s, {value['gflops']:.0f} GFLOP/s)"
    )
    table = Table("us")
    for heading in ("min", "p50", "p99", "max", "net p50", "x limit", "error"):
        table.add_column(heading, justify="right")
    table.columns[0].no_wrap = True
    for row in value["contenders"]:
        times = [_number(row[key]) for key in ("min_us", "p50_us", "p99_us", "max_us", "net_p50_us")]
        table.add_row(row["name"], *times, f"{row['of_limit']:.2f}", f"{row['parity_error']:.0e}")
    Console().print(table)


def _number(us: float) -> str:
    return f"{us:.1f}" if us < 1000 else f"{us:.0f}"


def show_targets(policies: list[dict[str, Any]]) -> None:
    """Where we stand against the better of ONNX Runtime and OpenVINO."""
    for value in policies:
        ours = value["contenders"][0]
        print(
            f"{'reached' if value['reached'] else 'MISSED '}  {value['policy']}: {ours['name']}"
            f" {ours['net_p50_us']:.1f} us, {value['ratio']:.3f} x {value['best_rival']}"
            f" (target: {value['target']})"
        )


def draw(path: Path, policies: list[dict[str, Any]]) -> None:
    """Bars of p50 with whiskers to p99, a mark at the machine's limit; log scale."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    names = list(dict.fromkeys(row["name"] for value in policies for row in value["contenders"]))
    width = 0.8 / len(names)
    figure, axes = plt.subplots(figsize=(3.5 + 1.6 * len(policies), 5.0), layout="constrained")
    for i, name in enumerate(names):
        x, p50, whisker = [], [], []
        for at, value in enumerate(policies):
            for row in value["contenders"]:
                if row["name"] == name:
                    x.append(at + (i - (len(names) - 1) / 2) * width)
                    p50.append(row["p50_us"])
                    whisker.append(row["p99_us"] - row["p50_us"])
        errors = [[0.0] * len(x), whisker]
        axes.bar(x, p50, width, yerr=errors, label=name, error_kw={"elinewidth": 0.8, "capsize": 1.5})
    limits = [value["limit_us"] for value in policies]
    begin, end = [at - 0.42 for at in range(len(limits))], [at + 0.42 for at in range(len(limits))]
    axes.hlines(limits, begin, end, color="black", linewidth=1.2, label="machine's limit")
    axes.set_yscale("log")
    axes.set_xticks(range(len(policies)), [v["policy"].replace("_", " ") for v in policies], rotation=15)
    axes.set(ylabel="one evaluation, us: p50, whisker p99", title="batch 1, one thread, float32")
    figure.legend(loc="outside right upper", fontsize="small")
    axes.grid(axis="y", alpha=0.3)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
    plt.close(figure)
