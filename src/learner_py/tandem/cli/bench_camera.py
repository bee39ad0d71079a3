"""`tandem bench camera`: what images cost, and that the control loop does not pay for them."""

import json
import os
import tempfile
from pathlib import Path
from typing import Annotated, Any

import typer

from tandem.cli.common import JsonOption, SetOption, fail, sentences, write_json

SIZES = (64, 96, 128)  # px, of a view


def camera(
    task: Annotated[str, typer.Option(help="Task whose scene is drawn.")] = "peg",
    frames: Annotated[int, typer.Option(help="Frames of each size.", min=20, max=100_000)] = 500,
    seconds: Annotated[
        float, typer.Option(help="Seconds of the real-time loop, with and without the camera each.", min=2.0)
    ] = 20.0,
    slices: Annotated[int, typer.Option(help="Turns that the two take.", min=1, max=100)] = 4,
    core: Annotated[
        int, typer.Option(help="Core of control loop and camera [default: the last that we may use].")
    ] = -1,
    overrides: SetOption = None,
    json_file: JsonOption = None,
) -> None:
    """Images a second and ms an image (all views drawn, JPEG and back) at 64, 96 and 128 px a view, on one core; then
    the 1 kHz loop in real time with and without the camera, in turns, on the same core: computing time of a tick and
    lateness (us).

    JSON: sizes {px: {frames_per_s, frame_ms {p50, p99, max}}}, loop {with_camera, without_camera} {ticks, overruns,
    tick_compute_us, wakeup_us}, late: images that came too late for their step.
    """
    from tandem import loop_bench, run_folder, scenario

    with sentences(), tempfile.TemporaryDirectory(prefix="tandem-bench-") as name:
        folder = Path(name)
        try:
            core, _ = loop_bench.cores(core)
        except loop_bench.LoopBenchError as error:
            fail(str(error))
        setting = scenario.compose(run_folder.CONFIG, task, "tandem", {"mode": "bench"}, overrides or [])
        sizes: dict[str, Any] = {}
        for size in SIZES:
            results = _run(folder / f"size-{size}", setting, core, "image", size, "lockstep", frames)
            sizes[str(size)] = _speed(results["camera"])
            print(_size_line(size, sizes[str(size)]), flush=True)
        turns: dict[str, list[dict[str, Any]]] = {"without_camera": [], "with_camera": []}
        camera_px = int(setting.data["controller"]["camera"]["width_px"])
        for i in range(slices):
            for which, observe in (("without_camera", "state"), ("with_camera", "image")):
                steps = max(10, round(10 * seconds / slices))
                turn = folder / f"{which}-{i}"
                turns[which].append(_run(turn, setting, core, observe, camera_px, "realtime", steps))
            print(f"turn {i + 1} of {slices} of the real-time loop", flush=True)
    value: dict[str, Any] = {
        "sizes": sizes,
        "loop": {which: _loop(found) for which, found in turns.items()},
        "camera_px": camera_px,
        "images": sum(r["camera"]["frames"] for r in turns["with_camera"]),
        "late": sum(r["camera"]["late"] for r in turns["with_camera"]),
        "core": core,
        "load_average": os.getloadavg()[0],
        "git_revision": run_folder.git_revision(),
        "host": run_folder.host(),
    }
    _print(value)
    write_json(json_file, value)


def _run(
    folder: Path, setting: Any, core: int, observe: str, size: int, clock: str, steps: int
) -> dict[str, Any]:
    """The arm alone for so many policy steps. Returns the controller's results."""
    from tandem import processes, run_folder
    from tandem.processes import Child, Command

    changed = setting.copy_with(observe=observe, clock=clock, env_steps=steps)
    controller = changed.data["controller"]
    eye = {**controller["camera"], "width_px": size, "height_px": size}
    changed.data["controller"] = {**controller, "camera": eye}
    changed.write(folder / "scenario.yaml")
    command: Command = [
        run_folder.program("tandem_controller"), "--lcm-url", "memq://",
        "--scenario", folder / "scenario.yaml", "--run", folder, "--results", folder / "results.json",
    ]  # fmt: skip
    if sentence := processes.missing_program(command):
        fail(sentence)
    child = Child("controller", ["taskset", "--cpu-list", str(core), *command], folder / "controller.out")
    try:
        if child.wait(900.0) != 0:
            fail(changed.explain(child.death()))
    finally:
        child.stop(10.0)
    value: dict[str, Any] = json.loads((folder / "results.json").read_text())
    (folder / "log.lcm").unlink()
    return value


def _speed(camera: dict[str, Any]) -> dict[str, Any]:
    frame_ms = {name: 1e-3 * camera["frame_us"][name] for name in ("p50", "p99", "max")}
    return {"frames_per_s": 1e3 / frame_ms["p50"], "frame_ms": frame_ms}


def _loop(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Over all turns of one kind."""
    from tandem.histogram import Histogram, added

    def percentiles(name: str) -> dict[str, float]:
        return added(Histogram.of_controller(r[f"{name}_histogram_us"]) for r in found).percentiles()

    return {
        "ticks": sum(r["ticks"] for r in found),
        "overruns": sum(r["overruns"] for r in found),
        "tick_compute_us": percentiles("tick_compute"),
        "wakeup_us": percentiles("wakeup"),
    }


def _size_line(size: int, speed: dict[str, Any]) -> str:
    ms = speed["frame_ms"]
    return (
        f"{size} px: {speed['frames_per_s']:.0f} images/s;"
        f" {ms['p50']:.1f} ms an image, p99 {ms['p99']:.1f}, max {ms['max']:.1f}"
    )


def _print(value: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(
        "us", "tick p50", "tick p99", "tick p99.9", "late p50", "late p99", "late p99.9", "overruns"
    )
    for which, found in value["loop"].items():
        cells = [
            f"{found[key][p]:.1f}" for key in ("tick_compute_us", "wakeup_us") for p in ("p50", "p99", "p999")
        ]
        table.add_row(which.replace("_", " "), *cells, f"{found['overruns']} of {found['ticks']}")
    Console().print(table)
    print(
        f"{value['images']} images of {value['camera_px']} px beside the loop, on its core;"
        f" {value['late']} came too late for their step."
    )
    if value["load_average"] > 1.5:
        print(f"The machine is busy (load {value['load_average']:.1f}); measure it idle.")
