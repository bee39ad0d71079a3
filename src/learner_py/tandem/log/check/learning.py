"""Checks of what the learner learns from: episodes, steps, actions, returns, policies."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable

import numpy as np

from tandem.faults import fault_text
from tandem.log.check.findings import Report, shown
from tandem.log.check.run import Run
from tandem.log.event_log import EventLog
from tandem.log.events import Array

_FLOAT = 1e-6  # rounding of what goes over the wire as float


def episodes(run: Run, report: Report) -> None:
    names = ("episode", "phase", "outcome", "fault", "n_steps", "env_steps_total")
    ends = run.log.columns("EPISODE_END", *names, rows=run.log.episodes.last)
    number, jump = ends["episode"], np.diff(ends["episode"])
    report.where(
        "episodes",
        np.append(False, jump != 1) if len(number) else np.zeros(0, bool),
        lambda i: f"it comes after episode {number[i - 1]}; the next one must have the next number.",
        number,
    )
    trained = np.where(ends["phase"] == 1, ends["n_steps"], 0)
    off = np.diff(ends["env_steps_total"]) - trained[1:]
    report.where(
        "episodes",
        np.append(False, (off != 0) & (jump == 1)) if len(number) else np.zeros(0, bool),
        lambda i: (
            f"env_steps_total is {ends['env_steps_total'][i]} after {ends['env_steps_total'][i - 1]} and"
            f" {trained[i]} training steps."
        ),
        number,
    )
    report.where(
        "faults",
        ends["fault"] != 0,
        lambda i: f"it ended because of: {fault_text(int(ends['fault'][i]))}.",
        number,
    )


_STEP = (
    *("episode", "step", "policy_action", "human_action", "executed_action", "alpha", "intervention"),
    *("terminated", "truncated", "reward", "discounted_return", "policy_version"),
)


def steps(run: Run, report: Report) -> dict[str, Array]:
    """All steps, each once, by episode and step; `span` is the row of `log.episodes` that each belongs to."""
    log = run.log
    steps = log.columns("EPISODE_STEP", *_STEP)
    span = log.episodes.of(steps["row"])
    numbers = np.append(log.episodes.number, -1)
    stray = (span < len(log.episodes)) & (steps["episode"] != numbers[span])
    for number in np.unique(steps["episode"][stray]):
        report.add("episodes", "its steps are there and its end is not.", number)
    steps, span = {name: column[~stray] for name, column in steps.items()}, span[~stray]
    # The last of those that came again counts, and what no end follows was run again.
    order = np.lexsort((steps["row"], steps["step"], span))
    once = np.append(np.diff(steps["step"][order]) != 0, True)[: len(order)]
    once |= np.append(np.diff(span[order]) != 0, True)[: len(order)]
    order = order[once & (span[order] < len(log.episodes))]
    steps = {name: column[order] for name, column in steps.items()} | {"span": span[order]}
    _complete(log, steps, report)
    return steps


def _complete(log: EventLog, steps: dict[str, Array], report: Report) -> None:
    ends = log.columns("EPISODE_END", "episode", "n_steps", "steps_sha256", rows=log.episodes.last)
    bounds = np.searchsorted(steps["span"], np.arange(len(log.episodes) + 1))
    by_row = np.argsort(steps["row"])
    data: dict[int, bytes] = {}
    reader = zip(steps["row"][by_row].tolist(), log.events(steps["row"][by_row]), strict=False)
    for i, (begin, end) in enumerate(itertools.pairwise(bounds)):
        number, wanted = ends["episode"][i], int(ends["n_steps"][i])
        rows = steps["row"][begin:end].tolist()
        while len(data) < len(rows):
            row, event = next(reader)
            data[row] = event.data
        found = steps["step"][begin:end]
        digest = hashlib.sha256(b"".join(data[row] for row in rows)).hexdigest()
        data.clear()
        if not np.array_equal(found, np.arange(wanted)):
            missing = sorted(set(range(wanted)) - set(found.tolist()))
            what = f"steps {', '.join(map(str, missing[:5]))} are missing" if missing else "there are others"
            report.add("steps", f"{len(found)} of {wanted} steps: {what}.", number)
        elif digest != ends["steps_sha256"][i]:
            report.add("steps", "the digest of its steps is not the one that its end tells.", number)


def actions(run: Run, steps: dict[str, Array], report: Report) -> None:
    episode, tick = steps["episode"], steps["step"].astype(np.int64) * run.ticks_per_step
    if not len(episode):
        return
    policy, human, executed = (steps[f"{who}_action"] for who in ("policy", "human", "executed"))
    alpha, intervention = steps["alpha"], steps["intervention"] != 0

    def where(kind: str, wrong: Array | np.bool_, sentence: Callable[..., str]) -> None:
        report.where(kind, wrong, sentence, episode, tick)

    for name, action in (("policy", policy), ("human", human), ("executed", executed)):
        beyond = ~(np.abs(action) <= 1.0 + _FLOAT).all(axis=1)
        where(
            "actions",
            beyond,
            lambda i, n=name, a=action: f"the {n} action is {shown(a[i])}, beyond [-1, 1].",
        )
    where(
        "actions",
        (executed[:, :6] * run.masked != 0).any(axis=1),
        lambda i: f"the executed action is {shown(executed[i])}; the task moves fewer axes.",
    )
    where(
        "actions",
        ~((alpha >= 0) & (alpha <= 1)),
        lambda i: f"the human's authority is {alpha[i]:g}, beyond [0, 1].",
    )
    where(
        "intervention",
        ~intervention & (human != 0).any(axis=1),
        lambda i: f"no intervention, and a human action of {shown(human[i])}.",
    )
    if not run.lockstep:
        return  # in real time a step may see several chunks and commands
    asked = np.stack(
        [
            np.zeros_like(executed),
            np.where(alpha[:, None] < 1, policy, 0),
            np.where(alpha[:, None] > 0, human, 0),
        ]
    )
    low, high = asked.min(axis=0) - _FLOAT, asked.max(axis=0) + _FLOAT
    outside = ((executed < low) | (executed > high))[:, :6].any(axis=1)
    where(
        "executed",
        outside,
        lambda i: (
            f"executed {shown(executed[i])}; the policy asked {shown(policy[i])}, the human {shown(human[i])},"
            f" whose authority was {alpha[i]:g}."
        ),
    )
    commands = run.log.columns("TELEOP_COMMAND", "episode_answered", "tick_answered", "engaged")
    if len(commands["row"]):
        answered = {
            (e, t): bool(on)
            for e, t, on in zip(
                *(commands[name].tolist() for name in ("episode_answered", "tick_answered", "engaged")),
                strict=True,
            )
        }
        engaged = np.array([answered.get(key) for key in zip(episode.tolist(), tick.tolist(), strict=True)])
        where(
            "intervention",
            np.array([on is not None for on in engaged]) & (engaged != intervention),
            lambda i: (
                f"intervention is {int(intervention[i])}, and the operator's command said {int(engaged[i])}."
            ),
        )


def returns(run: Run, steps: dict[str, Array], report: Report) -> None:
    episode, tick = steps["episode"], steps["step"].astype(np.int64) * run.ticks_per_step
    if not len(episode):
        return
    outcome = run.log.episodes.outcome[steps["span"]]
    last = np.append(np.diff(steps["span"]) != 0, True)
    for name, wanted in (
        ("reward", (last & (outcome == 0)).astype(float)),
        ("terminated", last & np.isin(outcome, (0, 4))),
        ("truncated", last & (outcome == 1)),
    ):
        report.where(
            "returns",
            steps[name] != wanted,
            lambda i, n=name, w=wanted: f"{n} is {steps[n][i]:g}, and by the outcome {float(w[i]):g}.",
            episode,
            tick,
        )
    if run.discount is None:
        return
    # G_t = r_t + gamma G_t+1 for all episodes at once, from their ends
    left = np.zeros(len(last), np.int64)  # steps to the end of the episode
    ends = np.flatnonzero(last)
    left = ends[np.searchsorted(ends, np.arange(len(last)))] - np.arange(len(last))
    returns = np.zeros(len(last))
    for i in range(int(left.max(initial=0)) + 1):
        at = np.flatnonzero(left == i)
        returns[at] = steps["reward"][at] + (run.discount * returns[at + 1] if i else 0.0)
    logged = steps["discounted_return"]
    report.where(
        "returns",
        ~(np.abs(logged - returns) <= _FLOAT),
        lambda i: (
            f"the return is {logged[i]:g}; from the rewards and discount {run.discount:g} it is {returns[i]:g}."
        ),
        episode,
        tick,
    )


def policies(log: EventLog, steps: dict[str, Array], report: Report) -> None:
    names = ("version", "path", "n_bytes", "sha256")
    announced = log.columns("POLICY_ANNOUNCE", *names)
    acted = steps["policy_version"]
    unknown = (acted > 0) & ~np.isin(acted, announced["version"])
    # a run that evaluates one policy announces none
    if len(announced["row"]):
        first = (
            unknown & np.append(True, (np.diff(steps["span"]) != 0) | (np.diff(acted) != 0))[: len(unknown)]
        )
        report.where(
            "policies", first, lambda i: f"policy {acted[i]} acted and was never announced.", steps["episode"]
        )
    for version, path, n_bytes, sha256 in zip(*(announced[name].tolist() for name in names), strict=True):
        file = log.path.parent / str(path)
        if not file.is_file():
            continue
        content = file.read_bytes()
        if len(content) != n_bytes or hashlib.sha256(content).hexdigest() != sha256:
            report.add("policies", f"policy {version}: {file} is not the file that was announced.")
