"""The questions that a soak answers, each about plain data, so that a test can ask them without a robot."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tandem_lcm.tandem.controller_fault_t import controller_fault_t
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.world_state_t import world_state_t

from tandem.faults import fault_text
from tandem.soak.torques import TorqueFigures, check_torques

_LEARNT_OUTCOMES = (episode_end_t.SUCCESS, episode_end_t.TIMEOUT, episode_end_t.FAILURE)


@dataclass
class Check:
    """One question, its answer in a sentence, and the figures behind it."""

    name: str
    passed: bool
    sentence: str
    figures: dict[str, Any] = field(default_factory=dict)


def is_declared(fault: int) -> bool:
    """Is it a cause that Fault in fault.h names?"""
    return fault != 0 and fault_text(fault) != f"fault {fault}"


def is_learnable(end: episode_end_t) -> bool:
    """What the controller's side promises the learner: written here anew, so that it checks the learner's own rule."""
    if end.n_steps == 0 or end.outcome not in _LEARNT_OUTCOMES:
        return False
    if end.phase == world_state_t.DEMONSTRATION:
        return end.outcome == episode_end_t.SUCCESS
    return end.phase == world_state_t.TRAINING


def torques_within_limits(log: Path) -> Check:
    figures: TorqueFigures = check_torques(log)
    sentence = (
        f"{figures.ticks} ticks; largest torque {100 * figures.largest_share:.0f}% of its limit, largest change "
        f"{figures.largest_step:.4f} N m"
    )
    if figures.violations:
        sentence = f"{figures.violations} of {figures.ticks} ticks break a limit; {figures.first_violation}"
    elif figures.ticks == 0:
        sentence = "the log holds no tick"
    return Check(
        "torque limits on every tick",
        figures.ticks > 0 and figures.violations == 0,
        sentence,
        {
            "ticks": figures.ticks,
            "not_finite": figures.not_finite,
            "beyond_limit": figures.beyond_limit,
            "beyond_step": figures.beyond_step,
            "undecodable": figures.undecodable,
            "missed_cycles": figures.missed_cycles,
            "largest_share_of_limit": figures.largest_share,
            "largest_step_Nm": figures.largest_step,
        },
    )


def faults_declared(
    faults: Sequence[controller_fault_t],
    ends: Sequence[episode_end_t],
    begun: Collection[int],
    halted_by: Mapping[int, int],
    ended_well: bool,
) -> Check:
    """begun: episodes that the log shows running; halted_by: fault -> times that CONTROLLER_STATUS said so."""
    wrong = []
    of_episode: dict[int, episode_end_t] = {end.episode: end for end in ends}
    told = Counter(fault.episode for fault in faults if fault.episode >= 0)
    last_begun = max(begun, default=-1)
    for fault in faults:
        end = of_episode.get(fault.episode)
        if not is_declared(fault.fault):
            wrong.append(f"episode {fault.episode} ended by the undeclared fault {fault.fault}")
        if fault.episode < 0:
            continue  # none was running
        if end is None:
            wrong.append(f"episode {fault.episode} has a fault but no end")
        elif (end.outcome, end.fault) != (episode_end_t.FAULT, fault.fault):
            wrong.append(
                f"episode {fault.episode} had fault {fault.fault} but ended with outcome {end.outcome}, "
                f"fault {end.fault}"
            )
        if fault.episode >= last_begun and not ended_well:
            wrong.append(
                f"after the fault of episode {fault.episode} neither an episode nor an orderly end came"
            )
    for end in ends:
        if end.outcome == episode_end_t.FAULT and told[end.episode] != 1:
            wrong.append(f"episode {end.episode} ended by a fault that was told {told[end.episode]} times")
        if end.outcome != episode_end_t.FAULT and end.fault != 0:
            wrong.append(f"episode {end.episode} ended with outcome {end.outcome} and fault {end.fault}")
    wrong += [
        f"the arm was halted by the undeclared fault {fault}" for fault in halted_by if not is_declared(fault)
    ]
    kinds = Counter(fault.fault for fault in faults)
    sentence = f"{len(faults)} faults of {len(kinds)} kinds, each declared, latched and recovered from"
    return Check(
        "every fault ended in a declared state",
        not wrong,
        "; ".join(wrong[:5]) or sentence,
        {
            "faults": {fault_text(kind): n for kind, n in sorted(kinds.items())},
            "halted": {fault_text(kind): n for kind, n in sorted(halted_by.items())},
        },
    )


def delivered_once(
    ends: Sequence[episode_end_t],
    acknowledged: Mapping[int, int],
    forged: Collection[int],
    buffer_steps: int | None,
    trained_through: int | None,
) -> Check:
    """forged: episodes acknowledged by somebody else, which the learner may have from the log instead.

    That no episode counts twice follows from the sum of steps, because nothing is missing from it either.
    """
    wrong = []
    numbers = [end.episode for end in ends]
    if numbers != list(range(len(numbers))):
        odd = next(i for i, number in enumerate(numbers) if number != i)
        wrong.append(f"the log's episode at place {odd} has the number {numbers[odd]}")
    wrong += [
        f"episode {number} was never acknowledged"
        for number in numbers
        if not acknowledged.get(number) and number not in forged
    ]
    learnable = [end for end in ends if is_learnable(end)]
    steps = sum(end.n_steps for end in learnable)
    if buffer_steps != steps:
        wrong.append(f"the learner holds {buffer_steps} steps, the log's learnable episodes have {steps}")
    if numbers and trained_through != numbers[-1]:
        wrong.append(
            f"the learner is trained through episode {trained_through}, the log's last is {numbers[-1]}"
        )
    outcomes = Counter(end.outcome for end in ends)
    sentence = f"{len(learnable)} learnable episodes with {steps} steps, each held once by the learner"
    return Check(
        "every completed episode delivered once",
        not wrong and bool(learnable),
        "; ".join(wrong[:5]) or (sentence if learnable else "no learnable episode was completed"),
        {
            "episodes": len(ends),
            "learnable": len(learnable),
            "steps": steps,
            "buffer_steps": buffer_steps,
            "outcomes": {
                name: outcomes[getattr(episode_end_t, name)]
                for name in ("SUCCESS", "TIMEOUT", "FAULT", "DISCARD", "FAILURE")
            },
        },
    )


def garbage_refused(
    status: Any, n_gains: int, n_gains_logged: int, n_garbage: int, strangers: Collection[str]
) -> Check:
    """n_gains: valid ones that were sent; n_gains_logged: those that the law was given.
    strangers: who else than the operator has a TELEOP_COMMAND in the log, which holds only what was taken.
    """
    wrong = []
    if status is None:
        wrong.append("the controller never told its status")
    else:
        if status.gains_accepted > n_gains:
            wrong.append(f"{status.gains_accepted} gains were taken, only {n_gains} were valid")
        if status.gains_accepted != n_gains_logged:
            wrong.append(
                f"{status.gains_accepted} gains were taken, but {n_gains_logged} of them came to the law"
            )
        if status.records_dropped:
            wrong.append(f"{status.records_dropped} records were dropped, so the log is incomplete")
    if strangers:
        wrong.append(f"the arm followed commands of {', '.join(sorted(strangers))}")
    return Check(
        "garbage refused, log complete",
        not wrong,
        "; ".join(wrong) or f"{n_garbage} senseless messages had no effect",
    )
