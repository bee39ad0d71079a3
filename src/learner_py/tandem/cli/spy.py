"""`tandem spy`."""

import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tandem.cli import address
from tandem.cli.common import JsonOption, fail, sentences, write_json

if TYPE_CHECKING:
    from tandem.run_folder import RunFolder
    from tandem.scenario import Scenario
    from tandem.spy.model import Model

ONCE_S = 3.0
PIPE_WIDTH = 160


def spy(
    log: Annotated[
        Path | None,
        typer.Argument(
            metavar="[LOG|RUN]", help="Event log to play, or a run's folder [default: live from LCM]."
        ),
    ] = None,
    lcm_url: Annotated[
        str | None,
        typer.Option(
            "--lcm",
            "--lcm-url",
            metavar="URL",
            help="LCM address [default: that of --run, else LCM_DEFAULT_URL, else that of the newest going run].",
        ),
    ] = None,
    run: address.RunOption = None,
    once: Annotated[
        bool, typer.Option("--once", help="Print one table and end; without a terminal this is the default.")
    ] = False,
    seconds: Annotated[
        float | None,
        typer.Option(help=f"End after so many seconds [default with --once: {ONCE_S:g}].", min=0.1),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """See every channel, what is in its messages, the robot and the learning: live, or from an event log.

    Pages: 1 channels (count, Hz, expected Hz, jitter: 99 % of the intervals are within so many ms of the median,
    gaps in the messages' numbers, kB/s, age, undecodable ones), 2 members of the channel under the cursor (Enter),
    3 robot, 4 learning, 5 events. A log plays in its own time, pauses between episodes left out: space pauses,
    . steps by one policy step, + and - change the speed, arrows seek by 5 s, n and p go to the next and the previous
    episode. With --once a log is read whole, as fast as it goes. JSON: source, seconds, messages, gaps, undecodable,
    channels [{channel, type, count, rate_hz, expected_hz, jitter_ms, gaps, bytes_per_s, age_s, latency_ms, ...}].
    """
    if log is not None and (lcm_url or run):
        fail("give either a log to play, or --lcm or --run to listen to, not both.", 2)
    once = once or not (sys.stdin.isatty() and sys.stdout.isatty())
    with sentences():
        value = _recorded(log, once, seconds) if log is not None else _live(lcm_url, run, once, seconds)
    write_json(json_file, value)


def _live(lcm_url: str | None, run: Path | None, once: bool, seconds: float | None) -> dict[str, Any]:
    from tandem.spy import once as without_terminal
    from tandem.spy.live import LiveSource
    from tandem.spy.model import Model

    url, folder = address.find(lcm_url, run)
    scenario = _scenario_of(folder)
    try:
        source = LiveSource(url)
    except RuntimeError as error:
        fail(str(error))

    def new_model() -> Model:
        return Model(scenario)

    try:
        if once:
            model = new_model()
            without_terminal.listen(source, model, seconds or ONCE_S)
            return _print(url, model)
        return _show(source, new_model, folder.path if folder else None, seconds)
    finally:
        source.close()


def _recorded(log: Path, once: bool, seconds: float | None) -> dict[str, Any]:
    from tandem.run_folder import RunFolder
    from tandem.spy import once as without_terminal
    from tandem.spy.model import Model
    from tandem.spy.recording import RecordedSource, Recording

    file = RunFolder(log).log if log.is_dir() else log
    if not file.is_file():
        fail(f"{file} does not exist; give an event log or a run folder.", 2)
    scenario = _scenario_in(file)

    def new_model() -> Model:
        return Model(scenario, robot_time=True if scenario else None)

    try:
        if once:
            model = new_model()
            recording = Recording(file)
            without_terminal.read(recording, model)
            recording.close()
            return _print(str(file), model)
        source = RecordedSource(file, file.parent)
    except ValueError as error:
        fail(str(error))
    try:
        return _show(source, new_model, file.parent, seconds)
    finally:
        source.close()


def _print(source: str, model: "Model") -> dict[str, Any]:
    from rich.console import Console

    from tandem.spy import channel_table, once

    if not model.channels:
        fail(f"not a single message on {source}; is a run going there? ./tandem doctor checks the network.")
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else PIPE_WIDTH
    value = once.figures(source, model)
    print(f"{source}: {value['messages']} messages in {value['seconds']:.1f} s")
    Console(width=width).print(channel_table.table(model.rows(), width))
    return value


def _show(
    source: Any, new_model: "Callable[[], Model]", run: Path | None, seconds: float | None
) -> dict[str, Any]:
    """The terminal view, to its end."""
    from tandem.spy import once
    from tandem.spy.app import Spy

    app = Spy(source, new_model, run, seconds)
    app.run()
    if app.return_code:
        raise typer.Exit(app.return_code)
    app.model.take(source.poll())  # what came since the last refresh
    return once.figures(source.title, app.model)


def _scenario_of(folder: "RunFolder | None") -> "Scenario | None":
    """Of a run that is going; expected rates come from it."""
    from tandem import scenario

    return scenario.load(folder.scenario) if folder is not None and folder.scenario.is_file() else None


def _scenario_in(log: Path) -> "Scenario | None":
    """Of a log, None when it has none (lcm-logger's have not)."""
    import yaml

    from tandem.log import scenario_yaml
    from tandem.scenario import SECTIONS, Scenario

    try:
        data = yaml.safe_load(scenario_yaml(log))
    except (ValueError, yaml.YAMLError):
        return None
    whole = isinstance(data, dict) and all(isinstance(data.get(name), dict) for name in SECTIONS)
    return Scenario(data) if whole else None
