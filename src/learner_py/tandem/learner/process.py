"""The learner process, from start to end.

For every episode in order of its number: receive it (from the event log of an earlier start, or from the wire), put it
into the buffer, train, write the policy, announce it. Restarting is the same loop: episodes that the checkpoint has
seen only go into the buffer, the rest is trained as if nothing had happened.
"""

from __future__ import annotations

import itertools
import math
import signal
import threading
import time
from pathlib import Path

from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.policy_announce_t import policy_announce_t

from tandem.learner.checkpoint import CheckpointError
from tandem.learner.config import LearnerScenario
from tandem.learner.episode import Episode
from tandem.learner.link import Link
from tandem.learner.trainer import Report, Trainer
from tandem.log import episodes
from tandem.policy_file import PolicyFileError, describe, read_header
from tandem.run_folder import RunFolder, git_revision, write_json

SILENCE_TOLD_S = (5.0, 30.0, 60.0, 90.0)  # sentences while the controller is silent
SILENCE_LIMIT_S = 120.0
FAREWELL_S = 5.0  # silence after which a controller that had nothing left to do counts as gone
LOG_RESCAN_S = 3.0

FINISHED, SILENT, BAD_INPUT, REFUSED, STOPPED = 0, 1, 2, 3, 130


class LearnerProcess:
    """@raises RuntimeError with a sentence when LCM does not open."""

    def __init__(self, scenario: LearnerScenario, run: Path, lcm_url: str | None) -> None:
        self.scenario = scenario
        self.run_folder = run
        # a controller that resumes may need any of the last lag + 2 policies; two more cost nothing
        self.n_kept_policies = scenario.run.learner_lag + 4
        self.trainer = Trainer(scenario, git_revision())
        self.link = Link(lcm_url, self.n_kept_policies, say)
        self._stop = threading.Event()
        self._saved = time.monotonic()
        self._reports: list[Report] = []  # of the present episode

    def stop(self) -> None:
        """Ends `run` after the present block of updates; from any thread."""
        self._stop.set()

    def stop_on_signals(self) -> None:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: self.stop())

    # ---- the loop

    def run(self) -> int:
        """Returns the exit code."""
        self.link.report(method=self.scenario.method.name, **_no_losses())
        self.link.start()
        try:
            return self._learn()
        except OSError as error:
            say(
                f"error: {error.filename or self.run_folder} can't be written ({error.strerror}). Everything learnt "
                "can be learnt again from the log: free disk space and start the same command again."
            )
            return BAD_INPUT
        except (ValueError, CheckpointError, PolicyFileError) as error:
            say(f"error: {error}")
            return BAD_INPUT if isinstance(error, CheckpointError) else REFUSED
        finally:
            self.link.close()

    def _learn(self) -> int:
        trainer = self.trainer
        self._resume()
        trainer.compile()
        say(
            f"ready: method {self.scenario.method.name}, "
            f"trained through episode {trainer.position.episodes_trained_through}"
        )
        if self.scenario.run.demonstrations == 0 and trainer.position.version == 0:
            trainer.position.version = 1
            self._publish_policy()
            self._evaluation_checkpoint(env_steps_before=0)

        for number in itertools.count():
            episode, exit_code = self._wait_for(number)
            if episode is None:
                break
            trainer.ingest(episode)
            if number <= trainer.position.episodes_trained_through:
                continue
            env_steps_before = trainer.position.env_steps
            self._reports = []
            if not trainer.train(episode, self._after_block):
                exit_code = STOPPED
                break
            if trainer.policy_is_due(episode):
                self._publish_policy()
                self._evaluation_checkpoint(env_steps_before)
            self._report(training=False)
            say(_line(episode, self._reports, trainer))
            self._save(every_s=self.scenario.method.learner.checkpoint_every_s)
        return self._end(exit_code)

    def _resume(self) -> None:
        """Takes up the checkpoint and the log, and announces the policies that are on disk already."""
        if self._checkpoint.exists():
            self.trainer.restore(self._checkpoint)
            say(f"resuming after {self.trainer.updates} updates")
        self._offer_log()
        for version, file in sorted(RunFolder(self.run_folder).policies().items()):
            if version <= self.trainer.position.version:
                self._announce(file)

    def _offer_log(self) -> None:
        log = self.run_folder / "log.lcm"
        if log.exists():
            for episode in episodes(log):
                self.link.offer(episode)

    def _wait_for(self, number: int) -> tuple[Episode | None, int]:
        """The episode, or None and the exit code when the run is over."""
        began = time.monotonic()
        rescanned = began
        told = 0.0
        while True:
            episode = self.link.take(number, timeout_s=0.1)
            if self.link.refusal is not None:
                say(f"error: {self.link.refusal}")
                return None, REFUSED
            if self._stop.is_set():
                return None, STOPPED
            if episode is not None:
                return episode, FINISHED
            now = time.monotonic()
            if self._run_is_over(now - began):
                self._offer_log()  # what the controller believes delivered, and what it had no time to deliver
                return self.link.take(number, timeout_s=0.0), FINISHED
            silence = min(self.link.silence_s, now - began)
            for limit in SILENCE_TOLD_S:
                if told < limit <= silence:
                    told = limit
                    say(
                        f"waiting for episode {number}: no CONTROLLER_STATUS for {silence:.0f} s on "
                        f"{self.link.wire.url}; is tandem_controller running there? "
                        f"The learner gives up after {SILENCE_LIMIT_S:.0f} s."
                    )
            if silence > SILENCE_LIMIT_S:
                say(f"error: no CONTROLLER_STATUS for {SILENCE_LIMIT_S:.0f} s; everything learnt is saved.")
                return None, SILENT
            # the controller is past this episode but it does not come: it may be in the log by now
            status = self.link.status
            if status is not None and status.episode > number and now - rescanned > LOG_RESCAN_S:
                rescanned = now
                self._offer_log()

    def _run_is_over(self, waited_s: float) -> bool:
        """Nothing more will come: the controller said so, or it has gone after its whole budget."""
        status = self.link.status
        if status is not None and status.state in (controller_status_t.FINISHED, controller_status_t.FAULTED):
            return status.episodes_unacknowledged == 0 or waited_s > FAREWELL_S
        spent = self.trainer.position.env_steps >= self.scenario.run.env_steps
        return spent and min(self.link.silence_s, waited_s) > FAREWELL_S

    def _after_block(self, report: Report) -> bool:
        self._reports.append(report)
        self._report(training=True, report=report)
        self._save(every_s=self.scenario.method.learner.checkpoint_every_s)
        return not self._stop.is_set()

    def _end(self, exit_code: int) -> int:
        position = self.trainer.position
        self._save(every_s=0.0)
        write_json(RunFolder(self.run_folder).buffer, self.trainer.buffer_digest())
        self._report(training=False)  # after a resume nothing may have been trained, and so nothing told
        if (
            exit_code == FINISHED
            and position.version > 0
            and position.env_steps >= self.scenario.run.env_steps
        ):
            self._write_evaluation_checkpoint()
        why = {FINISHED: "finished", STOPPED: "stopped", SILENT: "gave up", REFUSED: "stopped"}[exit_code]
        say(
            f"{why} after {self.trainer.updates} updates, trained through episode {position.episodes_trained_through}"
        )
        return exit_code

    # ---- files and messages

    @property
    def _checkpoint(self) -> Path:
        return self.run_folder / "learner" / "checkpoint.safetensors"

    def _save(self, every_s: float) -> None:
        if time.monotonic() - self._saved >= every_s:
            self.trainer.save(self._checkpoint)
            self._saved = time.monotonic()

    def _publish_policy(self) -> None:
        version = self.trainer.position.version
        path = self.run_folder / "policies" / f"policy_{version:06d}.safetensors"
        self.trainer.write_policy(path)
        self._announce(path)
        for old, file in RunFolder(self.run_folder).policies().items():
            if old <= version - self.n_kept_policies:
                file.unlink()

    def _announce(self, path: Path) -> None:
        file, header = describe(path), read_header(path)
        message = policy_announce_t()
        message.version = header.version
        message.path = str(path.relative_to(self.run_folder))
        message.n_bytes = file.n_bytes
        message.sha256 = file.sha256
        message.episodes_trained_through = header.episodes_trained_through
        message.updates = header.updates
        self.link.announce(message)

    def _evaluation_checkpoint(self, env_steps_before: int) -> None:
        """The first policy, and each that crosses a multiple of run.evaluation_every, is kept for evaluation."""
        every, position = self.scenario.run.evaluation_every, self.trainer.position
        if position.version == 1 or position.env_steps // every > env_steps_before // every:
            self._write_evaluation_checkpoint()

    def _write_evaluation_checkpoint(self) -> None:
        name = f"policy_at_{self.trainer.position.env_steps:07d}.safetensors"
        self.trainer.write_policy(self.run_folder / "checkpoints" / name)

    def _report(self, training: bool, report: Report | None = None) -> None:
        values: dict[str, float] = {}
        if report is not None:
            values = {
                "critic_loss": report.critic_loss,
                "actor_loss": report.actor_loss,
                "win_share": report.win_share,
                "win_share_human": report.win_share_human,
                "win_share_autonomous": report.win_share_autonomous,
                "wall_updates_per_s": report.n_updates / max(report.seconds, 1e-9),
            }
        self.link.report(
            episodes_trained_through=self.trainer.position.episodes_trained_through,
            updates_done=self.trainer.updates,
            buffer_steps=self.trainer.buffer.size,
            training=int(training),
            **values,
        )


def say(line: str) -> None:
    print(line, flush=True)


def _no_losses() -> dict[str, float]:
    names = ("critic_loss", "actor_loss", "win_share", "win_share_human", "win_share_autonomous")
    return dict.fromkeys(names, math.nan)


def _line(episode: Episode, reports: list[Report], trainer: Trainer) -> str:
    """One readable line about an episode and what was learnt from it."""
    parts = [
        f"episode {episode.number} {episode.phase}: {episode.outcome}, {episode.n_steps} steps "
        f"({episode.end.n_intervention_steps} by the human)"
    ]
    if reports:
        n, seconds = sum(r.n_updates for r in reports), sum(r.seconds for r in reports)
        last = reports[-1]
        parts.append(f"{n} updates in {seconds:.2f} s")
        figures = {"critic": last.critic_loss, "actor": last.actor_loss, "policy wins": last.win_share}
        parts += [f"{name} {value:.4f}" for name, value in figures.items() if not math.isnan(value)]
    elif not episode.is_learnable:
        parts.append("not learnt from")
    if trainer.policy_is_due(episode):
        parts.append(f"policy {trainer.position.version} after {trainer.position.env_steps} env steps")
    return "; ".join(parts)
