"""Checks of the motion: ticks that follow each other, torques, workspace, forces, overruns."""

from __future__ import annotations

import numpy as np

from tandem.log.check.findings import Report, shown
from tandem.log.check.run import Run
from tandem.log.event_log import EventLog
from tandem.log.events import Array
from tandem.log.rates import expected_hz
from tandem.soak.torques import ROUNDING, TORQUE_LIMIT, TORQUE_STEP


def world(run: Run, report: Report) -> None:
    world = run.log.columns("WORLD_STATE", "episode", "tick", "step")
    _follow(world, run.ticks_per_step, "WORLD_STATE", {}, report)


def _follow(
    block: dict[str, Array], stride: int, channel: str, before: dict[str, int], report: Report
) -> None:
    """Ticks of an episode follow at this stride. before: the last ones of the block before."""
    episode, tick = block["episode"].astype(np.int64), block["tick"].astype(np.int64)
    if not len(tick):
        return
    last_episode = np.append(before.get("episode", -1), episode[:-1])
    last_tick = np.append(before.get("tick", 0), tick[:-1])
    step = tick - last_tick
    # an episode that was begun again, and a message that was sent again, are no gaps
    gap = (episode == last_episode) & (step > stride)
    report.where(
        "gaps",
        gap,
        lambda i: f"{channel} has nothing between tick {last_tick[i]} and this one; it comes every {stride}.",
        episode,
        tick,
    )
    before["episode"], before["tick"] = int(episode[-1]), int(tick[-1])


def states(run: Run, report: Report) -> None:
    names = (
        *("episode", "tick", "tau_commanded", "F_ext_W", "force_bound_W", "alpha"),
        *("p_WE_reference", "q_measured", "p_WE_measured"),
    )
    hz = expected_hz(run.log.scenario).get("ROBOT_STATE")
    before: dict[str, int] = {}
    above = total = 0
    worst: tuple[float, str, int, int] = (1.0, "", 0, 0)
    low, high = run.workspace or (np.full(3, -np.inf), np.full(3, np.inf))
    for block in run.log.column_blocks("ROBOT_STATE", *names):
        episode, tick = block["episode"], block["tick"]
        if hz:
            _follow(block, round(1000 / hz), "ROBOT_STATE", before, report)
        _torque(block, report)
        finite = np.logical_and.reduce(
            [np.isfinite(block[name]).all(axis=1) for name in ("F_ext_W", "q_measured", "p_WE_measured")]
        )
        report.where("torque", ~finite, lambda i: "the robot's state is not finite.", episode, tick)
        report.where(
            "actions",
            ~((block["alpha"] >= 0) & (block["alpha"] <= 1)),
            lambda i, b=block: f"the human's authority is {b['alpha'][i]:g}, beyond [0, 1].",
            episode,
            tick,
        )
        reference = block["p_WE_reference"]
        outside = ((reference < low - 1e-3) | (reference > high + 1e-3)).any(axis=1)
        report.where(
            "workspace",
            outside,
            lambda i, r=reference: (
                f"the arm tracks {shown(r[i])} m, outside of {shown(low)} to {shown(high)}."
            ),
            episode,
            tick,
        )
        ratio = np.abs(block["F_ext_W"]) / np.maximum(block["force_bound_W"], 1e-12)
        ratio[(block["force_bound_W"] <= 0) | ~np.isfinite(ratio)] = 0.0
        above, total = above + int((ratio > 1).any(axis=1).sum()), total + len(tick)
        if len(tick) and ratio.max() > worst[0]:
            i, axis = np.unravel_index(int(ratio.argmax()), ratio.shape)
            values = f"{block['F_ext_W'][i, axis]:.1f} of {block['force_bound_W'][i, axis]:.1f}"
            worst = (
                float(ratio.max()),
                f"{values} {'N' if axis < 3 else 'N m'}",
                int(episode[i]),
                int(tick[i]),
            )
    if above:
        report.add(
            "force",
            f"{worst[1]} at the worst, here; {100 * above / total:.1f} % of {total} states are above what the law can"
            " press with at rest (impacts).",
            worst[2],
            worst[3],
            count=above,
        )


def _torque(block: dict[str, Array], report: Report) -> None:
    tau = block["tau_commanded"]
    wrong = ~(np.abs(tau) <= TORQUE_LIMIT + ROUNDING).all(axis=1)
    report.where(
        "torque",
        wrong,
        lambda i: f"commanded {shown(tau[i])} N m; the limits are {shown(TORQUE_LIMIT)}.",
        block["episode"],
        block["tick"],
    )


def ticks(run: Run, report: Report) -> None:
    names = ("episode", "tick", "missed_cycles", "tau_commanded", "tau_received")
    before: dict[str, int] = {}
    for block in run.log.column_blocks("CONTROL_TICK", *names):
        episode, tick, missed = block["episode"], block["tick"], block["missed_cycles"]
        _follow(block, 1, "CONTROL_TICK", before, report)
        _torque(block, report)
        change = np.abs(block["tau_commanded"] - block["tau_received"]).max(axis=1)
        report.where(
            "torque",
            ~(change <= TORQUE_STEP + ROUNDING),
            lambda i, c=change: (
                f"a torque changed by {c[i]:.4f} N m; the robot takes {TORQUE_STEP:g} a tick."
            ),
            episode,
            tick,
        )
        report.where(
            "overruns",
            missed > 0,
            lambda i, m=missed: f"{m[i]} control cycles passed without a command before this tick.",
            episode,
            tick,
        )


def status(log: EventLog, report: Report) -> None:
    status = log.columns("CONTROLLER_STATUS", "episode", "records_dropped")
    dropped = status["records_dropped"]
    if dropped.max(initial=0) > 0:
        i = int(np.argmax(dropped))
        report.add(
            "overruns",
            f"{dropped[i]} tick records were lost because the recorder was too slow; the log is incomplete.",
            status["episode"][i],
        )
