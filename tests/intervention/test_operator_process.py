"""tandem_operator on the wire: it presses the button after a fault, never after a stop that someone asked for."""

import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tandem_lcm.tandem.controller_command_t import controller_command_t
from tandem_lcm.tandem.controller_status_t import controller_status_t

from tandem.processes import free_lcm_url
from tandem.run_folder import CONFIG, program
from tandem.scenario import compose
from tandem.wire import Wire

COLLISION, USER_STOP, ESTOP = 6, 9, 23  # Fault in src/controller/robot/fault.h


@pytest.fixture
def wire(tmp_path: Path) -> Iterator[Wire]:
    """A network with the operator on it; ends with a controller's good end, which ends the operator."""
    scenario = tmp_path / "scenario.yaml"
    compose(CONFIG, "peg", "tandem", {}).write(scenario)
    wire = Wire(free_lcm_url())
    command = [str(program("tandem_operator")), "--scenario", str(scenario), "--lcm-url", wire.url]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            yield wire
            tell(wire, controller_status_t.FINISHED, 0, 0.3)
            assert process.wait(10) == 0
        finally:
            process.kill()


def tell(wire: Wire, state: int, fault: int, seconds: float) -> list[Any]:
    """Status ten times a second; the commands that came meanwhile."""
    heard: list[Any] = []
    wire.subscribe(controller_command_t, lambda command, _: heard.append(command))
    status = controller_status_t()
    status.state, status.fault = state, fault
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        wire.publish(status)
        time.sleep(0.1)
        wire.handle(0.0)
    return heard


def test_a_fault_is_recovered_from_with_patience(wire: Wire) -> None:
    assert tell(wire, controller_status_t.RUNNING, 0, 0.5) == []
    heard = tell(wire, controller_status_t.HALTED, COLLISION, 1.8)
    assert 1 <= len(heard) <= 3
    assert {command.order for command in heard} == {controller_command_t.RECOVER}


@pytest.mark.parametrize("fault", [ESTOP, USER_STOP])
def test_a_stop_that_someone_asked_for_stands(wire: Wire, fault: int) -> None:
    assert tell(wire, controller_status_t.HALTED, fault, 1.2) == []
