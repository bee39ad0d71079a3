"""`tandem command`: orders are confirmed by the controller's status, or the exit code is not 0."""

from collections.abc import Callable
from pathlib import Path

import pytest
from fake_controller import FakeController
from tandem_lcm.tandem.controller_command_t import controller_command_t
from tandem_lcm.tandem.controller_status_t import controller_status_t
from typer.testing import CliRunner

from tandem import gains, run_folder
from tandem.cli import command
from tandem.cli.app import app
from tandem.processes import free_lcm_url

LAW = {
    "stiffness": [2000.0] * 3 + [150.0] * 3,
    "damping_ratio": 1.0,
    "error_clip": [0.01] * 3 + [0.1] * 3,
}


@pytest.fixture(autouse=True)
def _hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "HEARD_S", 0.5)
    monkeypatch.setattr(command, "CONFIRMED_S", 2.0)
    monkeypatch.delenv("LCM_DEFAULT_URL", raising=False)


def give(*words: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["command", *words])
    return result.exit_code, result.output + result.stderr


@pytest.mark.parametrize(
    ("word", "order"),
    [
        ("estop", controller_command_t.ESTOP),
        ("stop", controller_command_t.STOP),
        ("discard", controller_command_t.DISCARD),
    ],
)
def test_an_order_that_is_confirmed_ends_well(word: str, order: int) -> None:
    with FakeController(free_lcm_url()) as controller:
        code, said = give(word, "--reason", "a test", "--lcm-url", controller.url)
    assert code == 0, said
    assert set(controller.orders) == {order}


@pytest.mark.parametrize("word", ["estop", "stop", "discard"])
def test_an_order_that_is_not_carried_out_fails_and_says_so(word: str) -> None:
    with FakeController(free_lcm_url(), obeys=False) as controller:
        code, said = give(word, "--lcm-url", controller.url)
    assert code == 1
    assert "did not confirm" in said


@pytest.mark.parametrize("word", ["estop", "stop", "recover", "discard", "gains"])
def test_without_a_controller_every_order_fails(word: str) -> None:
    code, said = give(word, "--lcm-url", free_lcm_url())
    assert code == 1
    assert "no controller is heard" in said


def test_recover_clears_a_fault_and_has_nothing_to_do_without_one() -> None:
    with FakeController(free_lcm_url()) as controller:
        assert "Nothing to recover" in give("recover", "--lcm-url", controller.url)[1]
        controller.status.state, controller.status.fault = controller_status_t.HALTED, 6
        assert give("recover", "--lcm-url", controller.url)[0] == 0
    assert controller.orders == [controller_command_t.RECOVER]
    with FakeController(free_lcm_url(), obeys=False) as controller:
        controller.status.state, controller.status.fault = controller_status_t.HALTED, 6
        code, said = give("recover", "--lcm-url", controller.url)
        assert code == 1 and "collision" in said


def test_gains_are_taken_or_refused() -> None:
    with FakeController(free_lcm_url()) as controller:
        code, said = give("gains", "--stiffness", "500,500,500,50,50,50", "--lcm-url", controller.url)
        assert code == 0, said
    (sent,) = controller.gains
    assert sent.stiffness[0][0] == 500 and sent.stiffness[0][1] == 0 and sent.stiffness[5][5] == 50
    assert sent.damping_ratio == 1.0 and sent.error_clip_low == sent.error_clip_high
    with FakeController(free_lcm_url(), takes_gains=False) as controller:
        code, said = give("gains", "--damping-ratio", "0.7", "--lcm-url", controller.url)
        assert code == 1 and "refused the gains: stiffness is too large" in said
    assert controller.gains[0].damping_ratio == 0.7


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: gains.message(LAW, "1,2", None, None, None), "has 2 numbers; it must have 6 or 36"),
        (lambda: gains.message(LAW, "1,2,3,4,5,x", None, None, None), "numbers with commas"),
        (lambda: gains.message(LAW, "-1,2,3,4,5,6", None, None, None), "eigenvalue -1"),
        (lambda: gains.message(LAW, "nan,2,3,4,5,6", None, None, None), "not finite"),
        (lambda: gains.message(LAW, None, -0.5, None, None), "--damping-ratio is -0.5"),
        (lambda: gains.message(LAW, None, None, "1,1,1,1,1,-1", None), "--error-clip"),
        (lambda: gains.message(LAW, None, None, None, "hand"), "base or tool"),
    ],
)
def test_bad_gains_are_refused_with_value_and_limit(make: Callable[[], object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        make()


def test_gains_take_what_is_not_given_from_the_scenario() -> None:
    full = [float(i == j) for i in range(6) for j in range(6)]
    law = {"stiffness": full, "damping": [5.0] * 6, "error_clip_low": [0.1] * 6, "error_clip_high": [0.2] * 6}
    message = gains.message({**law, "axes": "tool"}, None, None, None, None)
    assert message.tool_axes == 1 and message.damping_ratio < 0 and message.damping[2][2] == 5.0
    assert message.error_clip_low[0] == 0.1 and message.error_clip_high[0] == 0.2
    assert gains.message(law, None, 0.5, "0,0,0,1,1,1", "base").error_clip_low[0] == 0.0


def test_a_run_that_is_going_is_found_by_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_folder, "RUNS", tmp_path)
    run = tmp_path / "peg-tandem-seed0"
    run.mkdir()
    code, said = give("estop", "--run", str(run))
    assert code == 1 and "is not going now" in said
    with FakeController(free_lcm_url()) as controller:
        (run / "lcm_url").write_text(controller.url + "\n")
        assert give("discard", "--run", str(run))[0] == 0
        assert give("estop")[0] == 0  # the newest that is going
