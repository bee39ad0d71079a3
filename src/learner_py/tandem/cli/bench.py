"""`tandem bench`: `sim`, how fast we simulate, beside a peer in the same run; the others have files of their own."""

import json
import os
import statistics
import sys
import tempfile
from pathlib import Path
from typing import Annotated, Any

import typer

from tandem.cli import (
    bench_camera,
    bench_export,
    bench_handover,
    bench_learner,
    bench_log,
    bench_loop,
    bench_policy,
    bench_recording,
    bench_soak,
    bench_spy,
    bench_tracking,
)
from tandem.cli.common import JsonOption, SetOption, fail, sentences, write_json
from tandem.processes import Command

app = typer.Typer(help="Measure speed; each figure beside a peer's from the same run.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Measure speed; each figure beside a peer's from the same run."""


app.command("learner")(bench_learner.learner)
app.command("camera")(bench_camera.camera)
app.command("handover")(bench_handover.handover)
app.command("tracking")(bench_tracking.tracking)
app.command("log")(bench_log.log)
app.command("loop")(bench_loop.loop)
app.command("policy")(bench_policy.policy)
app.command("export")(bench_export.export)
app.command("soak")(bench_soak.soak)
app.command("spy")(bench_spy.spy)
app.command("recording")(bench_recording.recording)


@app.command("sim")
def sim(
    task: Annotated[str, typer.Option(help="Task of our side.")] = "peg",
    rounds: Annotated[
        int, typer.Option(help="Rounds of each side, alternately; the medians count.", min=1, max=100)
    ] = 3,
    env_steps: Annotated[int, typer.Option(help="Env steps (0.1 s) of our side per round.", min=10)] = 2000,
    seconds: Annotated[float, typer.Option(help="Seconds of the peer's side per round.", min=0.5)] = 6.0,
    core: Annotated[int, typer.Option(help="Core for both sides [default: the last that we may use].")] = -1,
    overrides: SetOption = None,
    json_file: JsonOption = None,
) -> None:
    """Env steps per second in lockstep on one core, 1 kHz loop included, beside gym_hil's PandaPickCube.

    Both sides: no images, resets counted in, 0.1 s of robot time per env step. gym_hil runs random actions,
    ours none. JSON: env_steps_per_s, gym_hil_env_steps_per_s, ratio (of medians), rounds.
    """
    from tandem import processes, run_folder, scenario

    allowed = sorted(os.sched_getaffinity(0))
    core = allowed[-1] if core < 0 else core
    if core not in allowed:
        fail(f"--core is {core}; this process may use {allowed}.", 2)
    results: list[dict[str, float]] = []
    with sentences(), tempfile.TemporaryDirectory(prefix="tandem-bench-") as name:
        folder = Path(name)
        values = {"mode": "bench", "env_steps": env_steps}
        setting = scenario.compose(run_folder.CONFIG, task, "tandem", values, overrides or [])
        for i in range(rounds):
            run = folder / f"round-{i}"
            setting.write(run / "scenario.yaml")
            ours: Command = [
                run_folder.program("tandem_controller"),
                "--scenario",
                run / "scenario.yaml",
                "--run",
                run,
                "--results",
                run / "results.json",
                "--lcm-url",
                "memq://",
            ]
            if sentence := processes.missing_program(ours):
                fail(sentence)
            _run_pinned("controller", ours, core, run / "controller.out", setting)
            raw = json.loads((run / "results.json").read_text())
            peer: Command = [
                sys.executable,
                "-m",
                "tandem.cli.gym_hil_speed",
                str(seconds),
                run / "gym_hil.json",
            ]
            _run_pinned("gym_hil", peer, core, run / "gym_hil.out", setting)
            speed = json.loads((run / "gym_hil.json").read_text())
            results.append(
                {
                    "env_steps_per_s": raw["env_steps_per_s"],
                    "gym_hil_env_steps_per_s": speed["env_steps_per_s"],
                }
            )
            print(
                f"round {i + 1} of {rounds}: ours {raw['env_steps_per_s']:.1f},"
                f" gym_hil {speed['env_steps_per_s']:.1f} env steps/s",
                flush=True,
            )
    value = report(results, core)
    print(
        f"{task}: {value['env_steps_per_s']:.1f} env steps/s;"
        f" gym_hil pick cube: {value['gym_hil_env_steps_per_s']:.1f};"
        f" ratio {value['ratio']:.2f} (medians of {rounds} rounds on core {core})"
    )
    if value["load_average"] > 1.5:
        print(
            f"The machine is busy (load {value['load_average']:.1f}); on an idle one the figures are higher."
        )
    write_json(json_file, value)


def report(results: list[dict[str, float]], core: int) -> dict[str, Any]:
    """Medians of the rounds under the names that other tools read."""
    from tandem import run_folder

    ours = statistics.median(r["env_steps_per_s"] for r in results)
    peer = statistics.median(r["gym_hil_env_steps_per_s"] for r in results)
    return {
        "env_steps_per_s": ours,
        "gym_hil_env_steps_per_s": peer,
        "ratio": ours / peer,
        "rounds": results,
        "core": core,
        "load_average": os.getloadavg()[0],
        "git_revision": run_folder.git_revision(),
        "host": run_folder.host(),
    }


def _run_pinned(name: str, command: Command, core: int, out: Path, setting: Any) -> None:
    """Runs a program on one core to its good end."""
    from tandem.processes import Child

    child = Child(
        name, ["taskset", "--cpu-list", str(core), *command], out, environment={"OMP_NUM_THREADS": "1"}
    )
    try:
        if child.wait(900.0) != 0:
            fail(setting.explain(child.death()))
    finally:
        child.stop(5.0)
