"""The learning page: does it get better, and by whose actions."""

import math
from typing import Any

from rich.text import Text
from tandem_lcm.tandem.episode_end_t import episode_end_t

from tandem.spy.fields import sparkline
from tandem.spy.model import Model
from tandem.statistics import percent, share
from tandem.teleop.screen import bar

_MARKS = {
    episode_end_t.SUCCESS: ("✓", "green"),
    episode_end_t.TIMEOUT: ("-", "yellow"),
    episode_end_t.FAULT: ("!", "bold red"),
    episode_end_t.DISCARD: ("·", "dim"),
    episode_end_t.FAILURE: ("✗", "red"),
}
_SHOWN_EVALUATIONS = 4


def rows(model: Model, evaluated: list[dict[str, Any]], encoding: str = "utf-8") -> list[tuple[str, Text]]:
    """Label and text, top to bottom. evaluated: env_steps, successes and episodes of the checkpoints, ascending."""
    progress = model.progress
    shown: list[tuple[str, Text]] = []
    status, learner, recent = progress.status, progress.learner, progress.recent
    if status is not None:
        done = share(status.env_steps_total, status.env_steps_budget)
        text = f"{bar(done, encoding)} {status.env_steps_total} of {status.env_steps_budget}"
        shown.append(("env steps", Text(f"{text}, {progress.env_steps_per_s:.0f} /s, {progress.phase}")))
    elif recent:
        shown.append(("env steps", Text(f"{recent[-1].env_steps_total} by the last episode")))
    if progress.demonstrations:
        shown.append(("demonstrations", Text(f"{progress.demonstrations} successful")))
    if recent:
        shown += _episodes(progress)
    for label, name in (
        ("all", "win_share"),
        ("human", "win_share_human"),
        ("autonomous", "win_share_autonomous"),
    ):
        if learner is not None and not math.isnan(value := getattr(learner, name)):
            wins = Text(f"{bar(value, encoding)} {100 * value:3.0f} %  ")
            wins.append(sparkline(model.series[name], encoding=encoding, whole=1.0), style="cyan")
            shown.append((f"wins, {label}", wins))
    if learner is not None:
        shown += _learner(model, learner, encoding)
    shown.append(("policy", _policy(model)))
    for value in evaluated[-_SHOWN_EVALUATIONS:]:
        text = f"at {value['env_steps']} env steps: {percent(value['successes'], value['episodes'])}"
        shown.append(("evaluated", Text(text)))
    if len(shown) == 1 and learner is None and model.announced is None:
        return [("", Text("no EPISODE_END and no LEARNER_STATUS yet", style="yellow"))]
    return shown


def _episodes(progress: Any) -> list[tuple[str, Text]]:
    recent, n = progress.recent, len(progress.recent)
    text = Text(f"{percent(progress.successes, n)} of the last {n}  ")
    for end in recent:
        mark, style = _MARKS.get(end.outcome, ("?", ""))
        text.append(mark, style=style)
    alone = sum(end.outcome == episode_end_t.SUCCESS and not end.n_intervention_steps for end in recent)
    human = f"{100 * progress.human_share:.0f} % of the steps, {sum(end.n_takeovers for end in recent)} take-overs"
    lengths = [end.n_steps for end in recent]
    return [
        ("success", text),
        ("without help", Text(f"{alone} of {n}")),
        ("human", Text(f"{human} in the last {n} episodes")),
        ("length", Text(f"{sum(lengths) / n:.1f} steps  ").append(sparkline(lengths), style="cyan")),
        ("peak force", Text(f"{max(end.force_peak for end in recent):.0f} N in the last {n} episodes")),
    ]


def _learner(model: Model, learner: Any, encoding: str) -> list[tuple[str, Text]]:
    doing = "training" if learner.training else "waiting for episodes"
    method = f"{learner.method}, " if learner.method else ""
    text = f"{method}{doing}, through episode {learner.episodes_trained_through};"
    text += f" {learner.updates_done} updates, {learner.wall_updates_per_s:.0f} /s; {learner.buffer_steps} steps held"
    shown = [("learner", Text(text))]
    for label, name in (("critic loss", "critic_loss"), ("actor loss", "actor_loss")):
        if not math.isnan(value := getattr(learner, name)):
            line = Text(f"{value:.4g}  ").append(sparkline(model.series[name], 48, encoding), style="cyan")
            shown.append((label, line))
    return shown


def _policy(model: Model) -> Text:
    status, recent = model.progress.status, model.progress.recent
    version = status.policy_version if status is not None else recent[-1].policy_version if recent else 0
    text = Text(f"version {version} in force")
    if (announced := model.announced) is not None:
        text.append(
            f"; {announced.version} announced, trained through episode {announced.episodes_trained_through}"
        )
    if (ack := model.acknowledged) is not None:
        verdict = "accepted" if ack.accepted else f"REFUSED: {ack.reason}"
        text.append(
            f"; {ack.version_answered} {verdict}, loaded in {ack.wall_load_us / 1000:.0f} ms",
            style="" if ack.accepted else "bold red",
        )
    if model.refused:
        text.append(f"; {model.refused} refused", style="red")
    return text
