"""What the pages show, from messages alone."""

import math
from typing import Any

import pytest
from spy_messages import end, robot, status, world
from tandem_lcm.tandem.controller_fault_t import controller_fault_t
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.learner_status_t import learner_status_t
from tandem_lcm.tandem.policy_ack_t import policy_ack_t
from tandem_lcm.tandem.policy_announce_t import policy_announce_t
from tandem_lcm.tandem.scenario_t import scenario_t

from tandem.scenario import Scenario
from tandem.spy import channel_table, expected, learning_page, robot_page
from tandem.spy.fields import members, numbers, sparkline, text
from tandem.spy.model import Batch, Model


def fed(*messages: tuple[str, Any], model: Model | None = None, at_us: int = 0) -> Model:
    model = model or Model()
    for i, (channel, message) in enumerate(messages):
        data = message if isinstance(message, bytes) else message.encode()
        model.take(Batch(at_us + 1000 * i, {channel: ([at_us + 1000 * i], [data])}))
    return model


def shown(rows: list[tuple[str, Any]]) -> str:
    return "\n".join(f"{label}: {line.plain}" for label, line in rows)


def test_robot_page_tells_mode_authority_forces_and_faults() -> None:
    state = robot(4, 500, alpha=0.75)
    state.F_ext_W = [1.0, -2.0, 19.0, 0.0, 0.0, 0.0]
    state.gripper_width = 0.0123
    state.limits_acted = 2 | 16
    fault = controller_fault_t()
    fault.episode, fault.tick, fault.sentence = 3, 77, "joint 4 left its range"
    page = shown(
        robot_page.rows(
            fed(
                ("WORLD_STATE", world(4, 5)),
                ("ROBOT_STATE", state),
                ("CONTROLLER_FAULT", fault),
                ("CONTROLLER_STATUS", status(state=5, episode=4, fault=23, faults_in_a_row=2, overruns=9)),
            )
        )
    )
    assert "halted" in page and "step 5 of 120, episode 4" in page
    assert "mode: moving" in page and "0.75" in page
    assert "+19.0/20" in page and "-2.0/20" in page
    assert "12.3 mm" in page and "wall, torque acted" in page
    assert "an e-stop command, 2 in a row" in page and "episode 3, tick 77: joint 4 left its range" in page
    assert "9 overruns" in page
    assert "nothing" not in shown(robot_page.rows(Model())) and "no ROBOT_STATE" in shown(
        robot_page.rows(Model())
    )


def test_learning_page_tells_success_win_shares_losses_and_versions() -> None:
    learner = learner_status_t()
    learner.method, learner.updates_done, learner.training = "tandem", 640, 1
    learner.critic_loss, learner.actor_loss = 0.125, math.nan
    learner.win_share, learner.win_share_human, learner.win_share_autonomous = 0.4, 0.9, 0.25
    announce, ack = policy_announce_t(), policy_ack_t()
    announce.version, announce.episodes_trained_through = 7, 30
    ack.version_answered, ack.accepted, ack.reason = 7, 0, "its golden examples differ by 0.3"
    ends = [end(i, human=5) for i in range(3)] + [end(3, episode_end_t.TIMEOUT), end(4)]
    model = fed(
        *(("EPISODE_END", one) for one in [*ends, ends[-1]]),  # sent again, counted once
        ("LEARNER_STATUS", learner),
        ("POLICY_ANNOUNCE", announce),
        ("POLICY_ACK", ack),
        ("CONTROLLER_STATUS", status(policy_version=6, env_steps_total=50)),
    )
    evaluated = [{"env_steps": 400, "successes": 45, "episodes": 50}]
    page = shown(learning_page.rows(model, evaluated))
    assert "(4/5) of the last 5  ✓✓✓-✓" in page and "without help: 1 of 5" in page
    assert "15 % of the steps, 3 take-overs" in page
    assert "wins, all" in page and " 40 %" in page and " 90 %" in page and " 25 %" in page
    assert "critic loss: 0.125" in page and "actor loss" not in page  # not a number is not shown
    assert "version 6 in force; 7 announced, trained through episode 30" in page
    assert "REFUSED: its golden examples differ by 0.3" in page
    assert "at 400 env steps: 90.0 %" in page and "50 of 100" in page


def test_events_are_told_once_and_in_order() -> None:
    model = fed(
        ("ROBOT_STATE", robot(0, 10, alpha=0.0)),
        ("ROBOT_STATE", robot(0, 20, alpha=1.0)),
        ("ROBOT_STATE", robot(0, 30, alpha=1.0)),
        ("ROBOT_STATE", robot(0, 40, alpha=0.0)),
        ("EPISODE_END", end(0)),
        ("EPISODE_END", end(0)),
    )
    told = [event.text for event in model.events]
    assert told[:2] == ["the human has the arm", "the policy has the arm"]
    assert sum("episode 0" in line for line in told) == 1 and told[-1] == "policy 1 is in force"


def test_expected_rates_follow_the_scenario_and_the_clock() -> None:
    scenario = Scenario({"run": {"robot_state_hz": 500}, "task": {"policy_rate_hz": 20}})
    assert expected.rates(scenario, robot_time=True)["ROBOT_STATE"] == 500
    assert expected.rates(scenario, robot_time=True)["WORLD_STATE"] == 20
    assert (
        expected.rates(scenario, robot_time=True, live=True)["ROBOT_STATE"] == 100
    )  # the link sends no more
    assert set(expected.rates(scenario, robot_time=False)) == {"CONTROLLER_STATUS", "LEARNER_STATUS"}
    # live the controller itself tells whether its time is ours
    assert fed(("CONTROLLER_STATUS", status(lockstep=0))).robot_time
    assert not fed(("CONTROLLER_STATUS", status(lockstep=1))).robot_time


def test_members_of_the_chosen_channel_are_kept_with_their_paths() -> None:
    model = Model()
    model.choose("ROBOT_STATE")
    fed(*(("ROBOT_STATE", robot(0, 10 * i)) for i in range(5)), model=model)
    history = model.fields.of("F_ext_W[2]")
    assert history is not None and list(history) == pytest.approx([0.0, 0.01, 0.02, 0.03, 0.04])
    model.choose("WORLD_STATE")
    assert model.fields.of("F_ext_W[2]") is None


def test_nested_messages_and_long_texts_become_a_tree() -> None:
    fault = controller_fault_t()
    fault.n_records, fault.last_records = 1, [robot(1, 2, alpha=0.5)]
    assert dict(numbers(fault))["last_records[0].alpha"] == 0.5
    assert "last_records" in dict(members(fault)) and text(fault.last_records) == "1 items"
    scenario = scenario_t()
    scenario.scenario_yaml = "a: 1\n" * 100
    assert "(500 characters)" in text(scenario.scenario_yaml) and "\n" not in text(scenario.scenario_yaml)


def test_sparkline_spans_from_least_to_greatest_and_survives_nan() -> None:
    assert sparkline([0, 1, 2, 3, 4, 5, 6, 7]) == "▁▂▃▄▅▆▇█"
    assert sparkline([3.0, 3.0, math.nan]) == "▁▁"
    assert sparkline([]) == "" and sparkline([1.0, math.inf]) == ""
    assert sparkline([0, 9], encoding="ascii").isascii()
    assert sparkline([0.5, 0.5, 1.0, 7.0], whole=1.0) == "▅▅██"


def test_hostile_messages_never_stop_the_pages() -> None:
    model = fed(*((channel, b"\xff" * 40) for channel in ("CONTROLLER_STATUS", "ROBOT_STATE", "EPISODE_END")))
    assert [row.undecodable for row in model.rows()] == [1, 1, 1]
    assert robot_page.rows(model) and learning_page.rows(model, [])


def test_the_narrow_table_fits_into_80_characters() -> None:
    assert sum(column.width + 1 for column in channel_table.columns(80)) <= 80
    rows = fed(("CONTROLLER_COMMAND_WITH_A_LONG_SUFFIX", b"1234567890")).rows()
    for width in (80, 200):
        for cell, column in zip(
            channel_table.cells(rows[0], width), channel_table.columns(width), strict=True
        ):
            assert cell.cell_len <= column.width


def test_of_many_states_in_a_batch_some_are_shown_and_the_last_one_always() -> None:
    model = Model()
    data = [robot(0, 10 * i, alpha=i / 999).encode() for i in range(1000)]
    model.take(Batch(1000, {"ROBOT_STATE": (list(range(1000)), data)}))
    shown = list(model.series["alpha"])
    assert 10 <= len(shown) <= 20 and shown == sorted(shown) and shown[-1] == 1.0
