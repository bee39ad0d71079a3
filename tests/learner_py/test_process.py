"""The learner process against a controller played by the test: nothing is lost, a resumed run is the same."""

from __future__ import annotations

import math
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import support
from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.episode_ack_t import episode_ack_t
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.episode_request_t import episode_request_t
from tandem_lcm.tandem.learner_status_t import learner_status_t
from tandem_lcm.tandem.policy_ack_t import policy_ack_t
from tandem_lcm.tandem.policy_announce_t import policy_announce_t
from tandem_lcm.tandem.world_state_t import world_state_t

from tandem.learner.config import LearnerScenario
from tandem.learner.process import FINISHED, REFUSED, STOPPED, LearnerProcess, _line
from tandem.learner.trainer import Report
from tandem.policy_file import describe, read_header, read_safetensors
from tandem.processes import free_lcm_url
from tandem.wire import Wire, utime

LAG = 1
N_DEMONSTRATIONS, N_EPISODES = 2, 7


def run_episodes():
    """Two demonstrations and five training episodes of 8 steps, the fourth discarded: 40 training steps."""
    for number in range(N_EPISODES):
        training = number >= N_DEMONSTRATIONS
        yield support.messages(
            number,
            phase=world_state_t.TRAINING if training else world_state_t.DEMONSTRATION,
            outcome=episode_end_t.DISCARD if number == 3 else episode_end_t.SUCCESS,
            n_steps=8,
            intervention=[0, 0, 1, 1, 0, 0, 0, 0] if training else [1] * 8,
            env_steps_total=8 * max(0, number - N_DEMONSTRATIONS + 1),
        )


class FakeController(threading.Thread):
    """Plays the controller in lockstep, and checks what it gets. Loses the steps that it is told to lose, once each."""

    def __init__(
        self,
        url: str,
        run: Path,
        lose=(),
        refuse="",
        n_refused=99,
        first_episode=0,
        announce_limit=99,
        deliver=99,
    ) -> None:
        super().__init__(daemon=True)
        self.wire, self.run_folder = Wire(url), run
        self.lose, self.refuse = set(lose), refuse
        self.first_episode, self.announce_limit = first_episode, announce_limit
        self.n_refused = n_refused  # announcements that `refuse` is the answer to
        self.deliver = deliver  # episodes from this on stay in the log; somebody else has acknowledged them
        self.episodes = list(run_episodes())
        self.number = first_episode
        self.acked: list[int] = []
        self.requests: list[tuple[int, list[int]]] = []
        self.policies: dict[int, policy_announce_t] = {}  # by episodes_trained_through
        self.statuses: list[tuple[float, learner_status_t]] = []
        self.done = threading.Event()
        self.state = controller_status_t.RUNNING
        self.wire.subscribe(episode_ack_t, lambda m, _: self.acked.append(m.episode_acknowledged))
        self.wire.subscribe(episode_request_t, self._on_request)
        self.wire.subscribe(policy_announce_t, self._on_announce)
        self.wire.subscribe(learner_status_t, lambda m, _: self.statuses.append((time.monotonic(), m)))

    def _on_request(self, request: episode_request_t, _data: bytes) -> None:
        self.requests.append((request.episode_requested, list(request.missing_steps)))
        if request.episode_requested >= self.deliver:
            return
        steps, end = self.episodes[request.episode_requested]
        for index in request.missing_steps or range(end.n_steps):
            self.wire.publish(steps[index])
        self.wire.publish(end)

    def _on_announce(self, announce: policy_announce_t, _data: bytes) -> None:
        path = self.run_folder / announce.path
        file = describe(path)
        assert (file.n_bytes, file.sha256) == (announce.n_bytes, announce.sha256)
        self.policies[announce.episodes_trained_through] = announce
        ack = policy_ack_t()
        refused = self.refuse != "" and self.n_refused > 0
        self.n_refused -= 1
        ack.version_answered, ack.accepted = announce.version, int(not refused)
        ack.reason = self.refuse if refused else ""
        self.wire.publish(ack)

    def _until(self, condition) -> None:
        last_status = 0.0
        while not condition() and not self.done.is_set():
            self.wire.handle(0.02)
            if time.monotonic() - last_status > 0.1:
                last_status = time.monotonic()
                status = controller_status_t()
                status.utime, status.wall_instance, status.state, status.episode = (
                    utime(),
                    id(self),
                    self.state,
                    self.number,
                )
                status.episodes_unacknowledged = sum(
                    n not in self.acked for n in range(self.first_episode, self.number)
                )
                self.wire.publish(status)

    def run(self) -> None:
        for number in range(self.first_episode, min(N_EPISODES, self.announce_limit)):
            self.number = number
            if number >= N_DEMONSTRATIONS:
                needed = max(number - 1 - LAG, N_DEMONSTRATIONS - 1)
                self._until(lambda needed=needed: needed in self.policies)
            steps, end = self.episodes[number]
            if number >= self.deliver:
                self.acked.append(number)
                continue
            for step in steps:
                if (number, step.step) in self.lose:
                    self.lose.discard((number, step.step))
                else:
                    self.wire.publish(step)
            self.number = number + 1
            ended = [0.0]

            def delivered(number=number, end=end, ended=ended) -> bool:
                if number not in self.acked and time.monotonic() - ended[0] > 0.5:
                    ended[0] = time.monotonic()
                    self.wire.publish(end)
                return number in self.acked

            self._until(delivered)
        if self.announce_limit >= N_EPISODES:
            self.state = controller_status_t.FINISHED
        self._until(lambda: False)

    def close(self) -> None:
        self.done.set()
        self.join()


def learn(
    run: Path, stop_after_updates: int | None = None, controller_type=FakeController, **facts
) -> tuple[int, FakeController, LearnerProcess]:
    """Runs learner and controller until the learner ends."""
    run.mkdir(exist_ok=True)
    url = free_lcm_url()
    controller = controller_type(url, run, **facts)
    process = LearnerProcess(LearnerScenario.model_validate(support.scenario_data()), run, url)
    if stop_after_updates is not None:
        after_block = process._after_block

        def stop(report):
            if process.trainer.updates >= stop_after_updates:
                process.stop()
            return after_block(report)

        process._after_block = stop  # type: ignore[method-assign]
    controller.start()
    exit_code = process.run()
    controller.close()
    return exit_code, controller, process


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """An undisturbed run."""
    run = tmp_path_factory.mktemp("reference")
    return (run, *learn(run))


def test_every_episode_is_acknowledged_trained_and_followed_by_its_policy(reference):
    run, exit_code, controller, process = reference
    assert exit_code == FINISHED
    assert sorted(set(controller.acked)) == list(range(N_EPISODES))
    assert {through: a.version for through, a in controller.policies.items()} == {
        1: 1,
        2: 2,
        3: 3,
        4: 4,
        5: 5,
        6: 6,
    }
    assert process.trainer.updates == 70 + 2 * 8 * 4  # the discarded episode pays for nothing
    assert read_header(run / "policies" / "policy_000006.safetensors").episodes_trained_through == 6


def test_checkpoints_for_evaluation_fall_on_multiples_and_the_end(reference):
    run = reference[0]
    names = sorted(path.name for path in (run / "checkpoints").iterdir())
    assert names == [f"policy_at_{steps:07d}.safetensors" for steps in (0, 24, 40)]
    assert read_header(run / "checkpoints" / names[1]).env_steps == 24


def test_only_the_last_few_policies_are_kept(reference):
    run = reference[0]
    kept = sorted(path.name for path in (run / "policies").iterdir())
    assert kept == [f"policy_{version:06d}.safetensors" for version in range(2, 7)]


def test_status_never_stops_for_long_and_carries_the_figures(reference):
    controller = reference[2]
    times = [t for t, _ in controller.statuses]
    assert max(np.diff(times)) < 3.0  # 0.8 s and what a busy machine adds
    trained = [status for _, status in controller.statuses if status.updates_done > 100]
    assert trained and all(
        0 <= s.win_share <= 1 and s.buffer_steps >= 24 and s.method == "mcbc" for s in trained
    )


def test_line_about_an_episode_says_no_figure_that_there_is_none_of(reference):
    process = reference[3]
    none = Report(64, 0.5, math.nan, 0.25, math.nan, math.nan, math.nan)
    line = _line(support.demonstration(1), [none], process.trainer)
    assert line.startswith(
        "episode 1 demonstration: success, 5 steps (0 by the human); 64 updates in 0.50 s; actor"
    )
    assert "nan" not in line


def same_policies(one: Path, other: Path) -> bool:
    """All tensors of the last policy and of the learner's checkpoint, bit by bit."""
    for name in ("policies/policy_000006.safetensors", "learner/checkpoint.safetensors"):
        a, b = read_safetensors(one / name)[0], read_safetensors(other / name)[0]
        if set(a) != set(b) or any(a[key].tobytes() != b[key].tobytes() for key in a):
            return False
    return True


def test_lost_steps_are_requested_and_change_nothing(reference, tmp_path):
    lost = [(0, 3), (2, 0), (2, 7), *((4, step) for step in range(8))]
    exit_code, controller, _ = learn(tmp_path / "run", lose=lost)
    assert exit_code == FINISHED
    assert {(0, (3,)), (2, (0, 7)), (4, tuple(range(8)))} <= {
        (n, tuple(steps)) for n, steps in controller.requests
    }
    assert same_policies(reference[0], tmp_path / "run")


@pytest.mark.parametrize("stop_after_updates", [1, 100])
def test_stopped_learner_resumes_from_log_and_checkpoint_to_the_same_bits(
    reference, tmp_path, stop_after_updates
):
    run = tmp_path / "run"
    exit_code, controller, process = learn(run, stop_after_updates=stop_after_updates)
    assert exit_code == STOPPED and process.trainer.updates < 134
    delivered = max(controller.acked) + 1
    support.write_log(run / "log.lcm", list(run_episodes())[:delivered])
    exit_code, _, process = learn(run, first_episode=delivered)
    assert exit_code == FINISHED and process.trainer.updates == 134
    assert same_policies(reference[0], run)


def test_killed_learner_without_a_checkpoint_trains_anew_from_the_log(reference, tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    support.write_log(run / "log.lcm", list(run_episodes())[:5])
    with (run / "log.lcm").open("ab") as log:
        log.write((run / "log.lcm").read_bytes()[:100])  # the controller was killed while it wrote
    exit_code, controller, _ = learn(run, first_episode=5)
    assert exit_code == FINISHED and controller.acked == [5, 6]
    assert same_policies(reference[0], run)


def test_acknowledged_episode_that_the_log_has_not_is_asked_for_again(reference, tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    support.write_log(run / "log.lcm", list(run_episodes())[:3])
    exit_code, controller, _ = learn(run, first_episode=5)
    assert exit_code == FINISHED and {(3, ()), (4, ())} <= {
        (n, tuple(steps)) for n, steps in controller.requests
    }
    assert same_policies(reference[0], run)


def test_refused_policy_stops_the_run_with_its_reason(tmp_path, capsys):
    exit_code, _, _ = learn(tmp_path / "run", refuse="golden.chunk differs by 0.1.")
    assert exit_code == REFUSED
    assert (
        "The controller refuses policy 1 (policies/policy_000001.safetensors): golden.chunk differs"
        in capsys.readouterr().out
    )


def test_refusal_of_somebody_elses_file_under_our_number_does_not_stop_the_run(tmp_path):
    exit_code, controller, _ = learn(
        tmp_path / "run", refuse="the file's SHA-256 is not the announced one.", n_refused=2
    )
    assert exit_code == FINISHED
    assert len(controller.policies) == N_EPISODES - N_DEMONSTRATIONS + 1


def test_last_episode_that_was_never_delivered_is_learnt_from_the_log(reference, tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    support.write_log(run / "log.lcm", list(run_episodes())[:-1])
    log_of_all = tmp_path / "all.lcm"
    support.write_log(log_of_all, list(run_episodes()))

    class LateLog(FakeController):
        """Its log holds the last episode from the very end on."""

        def _until(self, condition) -> None:
            if self.state == controller_status_t.FINISHED:
                (run / "log.lcm").write_bytes(log_of_all.read_bytes())
            super()._until(condition)

    exit_code, controller, process = learn(run, controller_type=LateLog, deliver=N_EPISODES - 1)
    assert exit_code == FINISHED
    assert process.trainer.position.episodes_trained_through == N_EPISODES - 1
    assert same_policies(reference[0], run)
    assert controller.statuses[-1][1].buffer_steps == process.trainer.buffer.size


def test_foreign_episode_under_a_known_number_stops_the_run(tmp_path, capsys):
    run = tmp_path / "run"
    run.mkdir()
    support.write_log(run / "log.lcm", [support.messages(0, phase=world_state_t.DEMONSTRATION, n_steps=4)])
    exit_code, _, _ = learn(run, first_episode=0)
    assert exit_code == REFUSED
    assert "must use the same run folder" in capsys.readouterr().out
