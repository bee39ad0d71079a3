"""`tandem bench handover`: policy swaps and hand-overs in real time, and what the control loop misses for them.

The real controller runs; handover_partner.py is its learner and its operator. Busy phases, in which policies are
swapped and somebody engages and lets go all the time, take turns with quiet phases of the same length, in which the
last policy drives alone: what the machine itself does to the loop shows there.
"""

import json
import math
import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tandem.cli.common import JsonOption, SetOption, fail, sentences, write_json
from tandem.faults import fault_text

if TYPE_CHECKING:
    from tandem.cli.handover_count import Phase

TICK_US = 1000.0
SIGNIFICANT = 0.05
TORQUE_JUMP_NM = 1.0 + 1e-9  # to reach; the difference of two numbers is rounded
AUTHORITY_TICKS = 50


def handover(
    swaps: Annotated[int, typer.Option(help="Policy swaps, at least.", min=1, max=10_000)] = 1000,
    handovers: Annotated[
        int, typer.Option(help="Hand-overs to a human and back, at least.", min=1, max=10_000)
    ] = 1000,
    task: Annotated[str, typer.Option(help="Task: a file of config/tasks.")] = "peg",
    run: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Keep the run in this new folder [default: a temporary one]."),
    ] = None,
    overrides: SetOption = None,
    json_file: JsonOption = None,
) -> None:
    """Swap policies and hand the arm over in real time; count the ticks that the control loop misses for it.

    Busy phases take turns with quiet ones of the same length (the policy drives, nothing else happens), because the
    machine itself misses ticks. As caused counts what is missed beyond the quiet phases' rate, in busy phases, in the
    20 ms after a swap or hand-over, and between such a tick and the next, where the loop stalls more often than in
    quiet phases (exact Poisson test, one-sided, p < 0.05); the largest of the three. The table shows all of it.
    1000 of each take about ten minutes and 1 GB of disk.
    """
    from tandem import processes, run_folder, scenario
    from tandem.cli.handover_partner import Partner, Wanted, write_policies

    if run is not None and run.exists():
        fail(f"{run} exists; --run needs a new folder.", 2)
    wanted = Wanted(swaps, handovers)
    with sentences(), tempfile.TemporaryDirectory(prefix="tandem-bench-") as name:
        folder = run_folder.RunFolder((run or Path(name) / "run").absolute())
        values = {
            "mode": "train",
            "clock": "realtime",
            "demonstrations": 0,
            "env_steps": 10_000_000,  # we end it
            "robot_state_hz": 1000,  # alpha of every tick
        }
        setting = scenario.compose(run_folder.CONFIG, task, "tandem", values, overrides or [])
        setting.write(folder.scenario)
        results, url = folder.path / "results.json", processes.free_lcm_url()
        command: processes.Command = [
            run_folder.program("tandem_controller"),
            *("--scenario", folder.scenario, "--run", folder.path, "--results", results, "--lcm-url", url),
        ]
        if sentence := processes.missing_program(command):
            fail(sentence)
        print(f"Writing {wanted.policies} policies.", flush=True)
        policies = write_policies(folder.path / "policies", setting.data, wanted.policies)
        print(f"Running for about {2.2 * wanted.busy_s + 5.0:.0f} s.", flush=True)
        load, stolen = [os.getloadavg()[0]], stolen_cpu_s()
        child = processes.Child("controller", command, folder.path / "controller.out")
        try:
            partner = Partner(url, policies, child, wanted)
            phases = partner.run()
            if partner.failure:
                fail(setting.explain(partner.failure))
            if child.stop(20.0) not in processes.STOPPED or not results.is_file():
                fail(setting.explain(child.death()))
        finally:
            child.stop(5.0)
        load.append(os.getloadavg()[0])
        stolen = stolen_cpu_s() - stolen
        print("Reading the log.", flush=True)
        value = report(folder, phases, json.loads(results.read_text()))
    value |= {
        "swaps_asked": swaps,
        "handovers_asked": handovers,
        "load_average": load,  # over 1 min, before and after
        "stolen_cpu_s": stolen,
        "git_revision": run_folder.git_revision(),
        "host": run_folder.host(),
    }
    value["not_reached"] = not_reached(value)
    show(value)
    write_json(json_file, value)


def report(folder: Any, phases: "list[Phase]", results: dict[str, Any]) -> dict[str, Any]:
    """The figures of a run, from its log and from what the controller measured itself."""
    from tandem.cli import handover_count

    value = handover_count.count(handover_count.read(folder.log), phases)
    return {
        **value,
        "missed_ticks_caused": caused(value),
        # Of the whole run, quiet phases and preemption included; the log does not tell when.
        "ticks_computing_beyond_1ms": handover_count.ticks_beyond(
            results["tick_compute_histogram_us"], TICK_US
        ),
        **{key: results[key] for key in ("tick_compute_us", "wakeup_us", "records_dropped")},
        "overruns": results["overruns"],  # missed ticks with those of the braking between episodes
        "tick_compute_histogram_us": results["tick_compute_histogram_us"],
        "wakeup_histogram_us": results["wakeup_histogram_us"],
        "warnings": _warnings(folder.path / "controller.out"),
    }


def caused(value: dict[str, Any]) -> int:
    """Missed ticks that swaps and hand-overs answer for; `handover` says how they are counted."""
    excesses = [
        math.ceil(part["missed_ticks_beyond_quiet"])
        for part in (value["busy"], value["within_20ms_after_event"], value["event_ticks"])
        if part["stalls_p_value"] < SIGNIFICANT
    ]
    return max(0, *excesses, 0)


def not_reached(value: dict[str, Any]) -> list[str]:
    """A sentence for each target that the run misses."""
    slowest = value["ticks_to_authority"]["max"] or 0
    jump, missed = value["largest_torque_jump_Nm"], value["missed_ticks_caused"]
    faults = ", ".join(
        f"{value['faults'].count(fault)} because {fault_text(fault)}"
        for fault in sorted(set(value["faults"]))
    )
    checks = [
        (
            value["swaps"] >= value["swaps_asked"],
            f"{value['swaps']} of {value['swaps_asked']} swaps came into force",
        ),
        (
            value["handovers"] >= value["handovers_asked"],
            f"{value['handovers']} of {value['handovers_asked']} hand-overs took place",
        ),
        (missed == 0, f"{missed} missed ticks count as caused, not 0"),
        (jump <= TORQUE_JUMP_NM, f"the torque jumped by {jump:.3f} N m in a tick, more than 1"),
        (slowest <= AUTHORITY_TICKS, f"alpha took {slowest} ticks to 0.9, more than {AUTHORITY_TICKS}"),
        (not faults, f"episodes ended in faults: {faults}"),
        (value["records_dropped"] == 0, f"{value['records_dropped']} records are missing in the log"),
    ]
    return [sentence for reached, sentence in checks if not reached]


def show(value: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(highlight=False, markup=False, soft_wrap=True)
    host, load, ticks = value["host"], value["load_average"], value["ticks_to_authority"]
    console.print(
        f"{host['cpu']}, {host['cores']} cores, {host['system']}, revision {value['git_revision']}\n"
        f"load average {load[0]:.1f} before, {load[1]:.1f} after; the hypervisor took {value['stolen_cpu_s']:.1f} s"
    )
    for warning in value["warnings"]:
        console.print(warning)
    console.print(
        f"{value['swaps']} swaps, {value['handovers']} hand-overs ({value['engagements_and_releases']} times"
        f" engaged or let go) in {value['ticks']} ticks of {value['episodes']} whole episodes\n"
        f"engaging to alpha >= 0.9: {ticks['min']} to {ticks['max']} ticks;"
        f" largest torque jump {value['largest_torque_jump_Nm']:.3f} N m in a tick"
    )
    table = Table("", box=None)
    for column in ("cycles", "missed", "stalls", "longest", "beyond quiet", "p"):
        table.add_column(column, justify="right")
    names = {
        "busy": "busy phases",
        "quiet": "quiet phases",
        "event_ticks": "ticks of an event",
        "within_20ms_after_event": "20 ms after an event",
    }
    for key, name in names.items():
        row = value[key]
        counts = (row["cycles"], row["missed_ticks"], row["stalls"], row["longest_stall_cycles"])
        test = (
            (f"{row['missed_ticks_beyond_quiet']:+.1f}", f"{row['stalls_p_value']:.2g}")
            if key != "quiet"
            else ()
        )
        table.add_row(name, *map(str, counts), *test)
    console.print(table)
    table = Table("us", box=None)
    for column in ("p50", "p99", "p99.9", "max"):
        table.add_column(column, justify="right")
    for name, key in (("tick computing", "tick_compute_us"), ("wake-up", "wakeup_us")):
        table.add_row(name, *(f"{value[key][q]:.1f}" for q in ("p50", "p99", "p999", "max")))
    console.print(table)
    console.print(
        f"Missed ticks caused: {value['missed_ticks_caused']}."
        f" Ticks of the whole run that computed beyond 1 ms: {value['ticks_computing_beyond_1ms']}."
    )
    if max(load) > 1.5:
        console.print("The machine was busy with other work; on an idle one less is missed, in both phases.")
    for sentence in value["not_reached"]:
        console.print(f"Not reached: {sentence}.")


def stolen_cpu_s() -> float:
    """CPU time since boot that a hypervisor gave to others while we wanted it; no priority helps against that."""
    return int(Path("/proc/stat").read_text().split(maxsplit=9)[8]) / os.sysconf("SC_CLK_TCK")


def _warnings(out: Path) -> list[str]:
    """What the machine refused to the control thread."""
    lines = out.read_text(errors="replace").splitlines() if out.is_file() else []
    return [line for line in lines if line.startswith("warning:")]
