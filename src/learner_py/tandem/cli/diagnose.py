"""`tandem diagnose RUN`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from tandem.cli.common import JsonOption, SetOption, fail, sentences, write_json


def diagnose(
    run: Annotated[Path, typer.Argument(help="Folder of a run, finished or not.")],
    updates: Annotated[int, typer.Option(help="Gradient updates before the questions.", min=1)] = 6000,
    overrides: SetOption = None,
    json_file: JsonOption = None,
) -> None:
    """What the critic can tell apart on episodes that it has not seen, and whom the operator helped.

    The learner runs again on four fifths of the run's episodes; the rest asks: does Q predict the return, does the
    human's chunk score above that of the policy that he stopped, an executed one above itself disturbed? With --set the
    learner runs with other settings, e.g. --set method.learner.critic.weight_decay=0.0.
    """
    from tandem.learner.xla import configure

    configure()
    from rich.console import Console
    from rich.table import Table

    from tandem.learner import diagnosis
    from tandem.learner.config import load_scenario
    from tandem.run_folder import RunFolder

    folder = RunFolder(run)
    if not folder.log.is_file():
        fail(f"{run} holds no log.lcm; give the folder of a run.", 2)
    with sentences():
        scenario = load_scenario(folder.scenario, overrides or [])
        try:
            value = diagnosis.diagnose(folder, scenario, updates)
        except ValueError as error:
            fail(str(error), 1)
    shown = Table(
        title=f"{run}: {value['method']}, {value['held_out_steps']} held-out steps", show_header=False
    )
    for label, text in _rows(value):
        shown.add_row(label, text)
    Console().print(shown)
    write_json(json_file, value)


def _rows(value: dict[str, Any]) -> list[tuple[str, str]]:
    def share(number: float | None) -> str:
        return "-" if number is None else f"{100 * number:.0f} %"

    def gain(number: float | None) -> str:
        return "-" if number is None else f"{number:+.3f}"

    operator = value["operator"]
    disturbed = ", ".join(f"{share(wins)} at {noise}" for noise, wins in value["disturbed_wins"].items())
    return [
        ("variance of the return that Q explains", share(value["r_squared"])),
        ("Q less the return", gain(value["overestimation"])),
        ("standard deviation over the ensemble", f"{value['spread_of_ensemble']:.3f}"),
        (
            "policy's chunk scores above the executed one",
            f"{share(value['policy_wins'])}, by {gain(value['policy_gain'])}",
        ),
        (
            "human's chunk scores above the stopped policy's",
            f"{share(value['human_wins'])} of {value['human_pairs']} pairs, by {gain(value['human_gain'])}",
        ),
        ("executed chunk plus noise scores above itself", disturbed),
        ("the same way a quarter quicker, against itself", gain(value["quicker_gain"])),
        (
            "episodes that the operator helped in",
            f"{share(operator['helped'])} of {operator['episodes']}; success {share(operator['success_helped'])},"
            f" without him {share(operator['success_alone'])}",
        ),
    ]
