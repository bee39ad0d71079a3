"""`tandem command ...`: orders to a controller that runs, from any terminal."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from tandem_lcm.tandem.controller_command_t import controller_command_t
from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.impedance_gains_t import impedance_gains_t

from tandem import orders
from tandem.cli.address import LcmUrlOption, RunOption, connect, find
from tandem.cli.common import fail, sentences
from tandem.faults import fault_text
from tandem.run_folder import CONFIG, RunFolder
from tandem.wire import Wire, utime
from tandem.words import STATES

HEARD_S = 2.0  # a controller tells its status ten times a second
CONFIRMED_S = 10.0  # to bring the arm to rest, to close the episode

app = typer.Typer(
    help="Orders to a running controller: e-stop, stop, recover, discard, gains. Exit code 0: it has confirmed.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

ReasonOption = Annotated[str, typer.Option(help="For the log.")]


class _Listener:
    """The controller's status over a wire."""

    def __init__(self, url: str) -> None:
        self.url = url
        self.wire: Wire = connect(url)
        self.status: Any = None
        self.heard_at = 0.0
        self.wire.subscribe(controller_status_t, self._hear)

    def _hear(self, status: Any, _data: bytes) -> None:
        self.status, self.heard_at = status, time.monotonic()

    def wait(self, until: Callable[[], bool], seconds: float, meanwhile: Callable[[], None]) -> bool:
        deadline = time.monotonic() + seconds
        while not until():
            if time.monotonic() > deadline:
                return False
            meanwhile()
            self.wire.handle(0.05)
        return True

    def first(self) -> Any:
        """A status of now."""
        if not self.wait(lambda: self.status is not None, HEARD_S, lambda: None):
            fail(f"no controller is heard on {self.url}; is the run going? Give its folder by --run.")
        return self.status

    @property
    def gone(self) -> bool:
        return self.status is not None and time.monotonic() - self.heard_at > orders.SILENCE_S


def _give(order: int, reason: str, lcm_url: str | None, run: Path | None, done: str) -> None:
    """Sends the order until it is confirmed; says so, or fails."""
    url, _ = find(lcm_url, run)
    listener = _Listener(url)
    # An e-stop does not wait to hear whom it stops.
    before: Any = None if order == controller_command_t.ESTOP else listener.first()
    if order == controller_command_t.RECOVER and before.state != controller_status_t.HALTED:
        print("Nothing to recover from: no fault is latched.")
        return
    if order == controller_command_t.DISCARD and before.state != controller_status_t.RUNNING:
        fail("no episode is running, so there is nothing to discard.")
    given = orders.Order(order, reason, before, time.monotonic())

    def send() -> None:
        if given.due(time.monotonic()):
            listener.wire.publish(given.message())

    send()

    def confirmed() -> bool:
        ended = order == controller_command_t.STOP and listener.gone
        return ended or given.done(listener.status)

    if not listener.wait(confirmed, CONFIRMED_S, send):
        if listener.status is None:
            fail(
                f"no controller is heard on {url}, so nobody has confirmed; the order was sent all the same."
            )
        status = listener.status
        state = f"it is {STATES.get(status.state, '?')}, {fault_text(status.fault)} latched"
        waiting = f"; it waits for {status.waiting_for}" if status.waiting_for else ""
        fail(f"the controller did not confirm within {CONFIRMED_S:.0f} s: {state}{waiting}.")
    print(done)


@app.command()
def estop(reason: ReasonOption = "by command", lcm_url: LcmUrlOption = None, run: RunOption = None) -> None:
    """Stop the arm now; latched until `recover`."""
    with sentences():
        _give(
            controller_command_t.ESTOP,
            reason,
            lcm_url,
            run,
            "The arm has stopped; ./tandem command recover goes on.",
        )


@app.command()
def stop(reason: ReasonOption = "by command", lcm_url: LcmUrlOption = None, run: RunOption = None) -> None:
    """End the running episode as discarded, then the run, in good order."""
    with sentences():
        _give(controller_command_t.STOP, reason, lcm_url, run, "The controller has ended.")


@app.command()
def recover(reason: ReasonOption = "by command", lcm_url: LcmUrlOption = None, run: RunOption = None) -> None:
    """Clear a latched fault and go on with the next episode."""
    with sentences():
        _give(controller_command_t.RECOVER, reason, lcm_url, run, "The fault is cleared; the run goes on.")


@app.command()
def discard(reason: ReasonOption = "by command", lcm_url: LcmUrlOption = None, run: RunOption = None) -> None:
    """End the running episode; it is not learnt from."""
    with sentences():
        _give(controller_command_t.DISCARD, reason, lcm_url, run, "The episode is discarded.")


@app.command()
def gains(
    stiffness: Annotated[
        str | None, typer.Option(help="6 numbers (N/m, then N m/rad) or 36 row by row, comma-separated.")
    ] = None,
    damping_ratio: Annotated[float | None, typer.Option(help="1 = critical.")] = None,
    error_clip: Annotated[
        str | None,
        typer.Option(
            help="6 numbers >= 0 (m, then rad): the stiffness acts on no larger error; bounds the force."
        ),
    ] = None,
    axes: Annotated[str | None, typer.Option(help="base or tool: in which axes all these are.")] = None,
    lcm_url: LcmUrlOption = None,
    run: RunOption = None,
) -> None:
    """Change the gains of the impedance law while it runs; they are ramped in.

    What is not given is as in the run's scenario (section controller.law), whatever was set since it began.
    """
    from tandem import gains as law
    from tandem import scenario

    with sentences():
        url, folder = find(lcm_url, run)
        try:
            message = law.message(_law_section(folder, scenario), stiffness, damping_ratio, error_clip, axes)
        except ValueError as error:
            fail(str(error), 2)
        listener = _Listener(url)
        before = listener.first()
        accepted, rejected = before.gains_accepted, before.gains_rejected
        _send_gains(listener, message)

        def judged() -> bool:
            return listener.status.gains_accepted > accepted or listener.status.gains_rejected > rejected

        if not listener.wait(judged, HEARD_S, lambda: None):
            fail("the controller did not answer to the gains; is the run going?")
        if listener.status.gains_accepted == accepted:
            fail(f"the controller refused the gains: {listener.status.last_rejection}")
    print("The controller has taken the gains.")


def _send_gains(listener: _Listener, message: impedance_gains_t) -> None:
    message.utime = utime()
    listener.wire.publish(message)


def _law_section(folder: RunFolder | None, scenario: Any) -> dict[str, Any]:
    if folder is not None and folder.scenario.exists():
        return dict(scenario.load(folder.scenario).data["controller"]["law"])
    body, _ = scenario.read_yaml(CONFIG / "controller.yaml", "config/controller.yaml")
    return dict(body["law"])
