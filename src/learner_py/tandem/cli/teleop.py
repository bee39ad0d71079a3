"""`tandem teleop keyboard|gamepad`."""

import sys
from enum import StrEnum
from typing import Annotated

import typer

from tandem.cli.address import LcmUrlOption, RunOption, connect, find
from tandem.cli.common import fail, sentences


class DeviceName(StrEnum):
    keyboard = "keyboard"
    gamepad = "gamepad"


def teleop(
    device: Annotated[
        DeviceName, typer.Argument(help="keyboard: of this terminal; gamepad: any that SDL knows.")
    ],
    lcm_url: LcmUrlOption = None,
    run: RunOption = None,
    within_training: Annotated[bool, typer.Option("--within-training", hidden=True)] = False,
) -> None:
    """Drive the arm: demonstrate, take over, label, stop. The keys are on the screen; arrows and page keys move, too.

    Sends TELEOP_COMMAND 50 times a second and shows mode, authority, forces against their bound and where the object
    is. The arm holds still, then goes back to the policy, when this program, its terminal or the pad is lost. Ctrl-C
    leaves. Works with a run in real time (./tandem train peg --clock realtime --operator none), for which
    `train --operator keyboard` starts it by itself.
    """
    from rich.console import Console

    from tandem.scenario import load
    from tandem.teleop.session import Session, stop_training
    from tandem.teleop.training import Training

    has_keys = sys.stdin.isatty()
    if device is DeviceName.keyboard and not has_keys:
        fail("the keyboard needs a terminal, and stdin is none.", 2)
    url, folder = find(lcm_url, run)
    wire = connect(url)
    with sentences():
        training = None
        if folder is not None and folder.scenario.exists():
            scenario = load(folder.scenario)
            shown_folder = folder
            training = lambda wire: Training(wire, shown_folder, scenario)  # noqa: E731
        try:
            driven = _open(device)
        except RuntimeError as error:
            fail(str(error))
        session = Session(
            wire,
            driven,
            f"teleop {device.value} · {url}",
            training,
            stop_training if within_training else lambda: True,
        )
        session.run(sys.stdin.fileno() if has_keys else None, Console())


def _open(device: DeviceName):  # type: ignore[no-untyped-def]
    if device is DeviceName.keyboard:
        from tandem.teleop.keyboard import Keyboard

        return Keyboard()
    from tandem.teleop.gamepad import Gamepad

    return Gamepad()
