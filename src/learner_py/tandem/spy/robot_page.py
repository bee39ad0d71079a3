"""The robot page: how the arm is, who has it, what it pushes against, what went wrong."""

from typing import Any

from rich.text import Text
from tandem_lcm.tandem.controller_status_t import controller_status_t

from tandem.faults import fault_text
from tandem.spy.fields import sparkline
from tandem.spy.model import Model
from tandem.teleop.screen import GRADES, SOURCES, bar, forces
from tandem.words import PHASES, ROBOT_MODES, STATES

_LIMITS = (
    "not finite",
    "wall",
    "joint position",
    "joint velocity",
    "torque",
    "torque rate",
)  # SafetyFilter::Limit


def rows(model: Model, encoding: str = "utf-8") -> list[tuple[str, Text]]:
    """Label and text, top to bottom; what is not known is left out."""
    status, robot, world = model.progress.status, model.latest("ROBOT_STATE"), model.latest("WORLD_STATE")
    shown: list[tuple[str, Text]] = []
    if status is not None:
        halted = status.state in (controller_status_t.HALTED, controller_status_t.FAULTED)
        text = f"{STATES.get(status.state, '?')}, {PHASES.get(status.phase, '?')}, episode {status.episode}"
        shown.append(("controller", Text(text, style="bold red" if halted else "bold")))
        if status.waiting_for:
            shown.append(("waiting for", Text(status.waiting_for, style="yellow")))
    if world is not None:
        text = (
            f"step {world.step} of {world.max_steps}, episode {world.episode}, {PHASES.get(world.phase, '?')}"
        )
        shown.append(("task", Text(text)))
    if robot is not None:
        shown += _arm(model, robot, encoding)
    if status is not None:
        shown += _controller(status)
    shown += _faults(model, robot, status)
    if not shown:
        shown.append(("", Text("no ROBOT_STATE and no CONTROLLER_STATUS yet", style="yellow")))
    return shown


def _arm(model: Model, robot: Any, encoding: str) -> list[tuple[str, Text]]:
    mode = ROBOT_MODES.get(robot.robot_mode, "?")
    cycles = f"{100 * robot.success_rate:.0f} % of the last 100 cycles in time"
    good = robot.robot_mode == 0 or (robot.robot_mode == 1 and robot.success_rate > 0.95)
    alpha = Text(f"{bar(robot.alpha, encoding)} {robot.alpha:.2f}  ")
    alpha.append(sparkline(model.series["alpha"], encoding=encoding, whole=1.0), style="cyan")
    acted = [name for bit, name in enumerate(_LIMITS) if robot.limits_acted >> bit & 1]
    x, y, z = robot.p_WE_measured
    force = Text(f"{model.series['force'][-1] if model.series['force'] else 0.0:6.1f} N  ")
    force.append(sparkline(model.series["force"], 48, encoding), style="cyan")
    shown = [
        ("mode", Text(f"{mode}, {cycles}", style="" if good else "bold red")),
        ("authority", alpha),
        *forces(robot, encoding),
        ("|force|", force),
        ("tool in W", Text(f"x {x:+.4f}  y {y:+.4f}  z {z:+.4f} m")),
        ("gripper", Text(f"{1000 * robot.gripper_width:.1f} mm")),
    ]
    if acted:
        shown.append(("limits", Text(", ".join(acted) + " acted", style="yellow")))
    return shown


def _controller(status: Any) -> list[tuple[str, Text]]:
    """What CONTROLLER_STATUS tells about the program."""
    ages = (status.wall_policy_age_ms, status.wall_teleop_age_ms, status.wall_learner_age_ms)
    named = zip(("policy", "operator", "learner"), ages, strict=True)
    heard = ", ".join(f"{name} {age:.0f} ms" if age >= 0 else f"{name} never" for name, age in named)
    stale = [
        f"{source} {GRADES[grade]}"
        for source, grade in zip(SOURCES, status.source_grade, strict=True)
        if 0 < grade < len(GRADES)
    ]
    shown = [
        (
            "last heard",
            Text(heard + (f"   silent: {', '.join(stale)}" if stale else ""), style="red" if stale else ""),
        )
    ]
    if not status.lockstep:
        tick, wake = status.wall_tick_us, status.wall_wakeup_us
        text = f"{status.overruns} overruns in {status.ticks} ticks; tick p99 {tick[1]:.0f}, max {tick[3]:.0f} us;"
        shown.append(("real time", Text(f"{text} wake-up p99 {wake[1]:.0f}, max {wake[3]:.0f} us")))
    chunks = f"{status.chunks_taken} taken, {status.chunks_late} late, {sum(status.chunks_refused)} refused;"
    shown.append(("chunks", Text(f"{chunks} {status.starved_ticks} ticks without one")))
    rejected = {
        "teleop": status.teleop_rejected,
        "gains": status.gains_rejected,
        "commands": status.commands_rejected,
        "learner": status.learner_rejected,
        "policies": status.policies_rejected,
    }
    if any(rejected.values()):
        text = ", ".join(f"{n} {name}" for name, n in rejected.items() if n)
        shown.append(("rejected", Text(f"{text}: {status.last_rejection}", style="yellow")))
    if status.records_dropped:
        shown.append(("log", Text(f"INCOMPLETE: {status.records_dropped} records dropped", style="bold red")))
    return shown


def _faults(model: Model, robot: Any, status: Any) -> list[tuple[str, Text]]:
    latched = (status.fault if status is not None else 0) or (robot.fault if robot is not None else 0)
    row = f", {status.faults_in_a_row} in a row" if status is not None and status.faults_in_a_row else ""
    text = Text(f"{fault_text(latched)}{row}", style="bold red" if latched else "green")
    shown = [("fault", text)] if status is not None or robot is not None else []
    for fault in reversed(model.faults):
        what = fault.sentence or fault_text(fault.fault)
        place = "between episodes" if fault.episode < 0 else f"episode {fault.episode}, tick {fault.tick}"
        shown.append(("", Text(f"{place}: {what}", style="red")))
    return shown
