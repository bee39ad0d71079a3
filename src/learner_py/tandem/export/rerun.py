"""A Rerun recording (.rrd): the arm in 3D, chunks as predicted and as executed, forces, who drives.

    world/panda/...                         the URDF, posed by ROBOT_STATE.q_measured; covers as the simulator has them
    world/tool, reference, object, goal     frames
    world/path                              way of the tool, one line an episode
    world/chunk/predicted, executed         tool positions that a chunk asks for, and what came of them
    world/force                             external force on the tool, 1 m = 100 N
    force/..., action/AXIS/..., alpha       curves
    driver, episode                         who drives, in lanes; what happened, in words

Time is that of the log: simulated in lockstep.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.urdf import UrdfTree

from tandem.export.source import Source, whole_or_not_at_all
from tandem.learner.episode import Episode
from tandem.run_folder import ROOT

PANDA = ROOT / "models/panda"
BASE_LINK = "link0"  # = W
TIMELINE = "sim_time"
METRES_PER_NEWTON = 0.01
FRAMES = {
    "tool": ("ROBOT_STATE", "p_WE_measured", "q_WE_measured"),
    "reference": ("ROBOT_STATE", "p_WE_reference", "q_WE_reference"),
    "object": ("WORLD_STATE", "p_WO", "q_WO"),
    "goal": ("WORLD_STATE", "p_WG", "q_WG"),
}
COLORS = {
    "policy": (240, 140, 30),
    "human": (60, 130, 240),
    "executed": (60, 180, 90),
    "force": (220, 60, 60),
    "path": (150, 150, 150),
    "cover": (225, 228, 230),
    "joint": (140, 147, 158),
    "dark": (60, 62, 68),
}

Floats = np.ndarray


class _Series(NamedTuple):
    """Messages of one type, and their fields as arrays."""

    messages: list[Any]

    def array(self, name: str) -> Floats:
        return np.array([getattr(message, name) for message in self.messages], np.float64)

    @property
    def time(self) -> list[rr.TimeColumn]:
        return [time_column(self.array("utime"))]


def time_column(utime: Floats | Sequence[float]) -> rr.TimeColumn:
    return rr.TimeColumn(TIMELINE, duration=np.asarray(utime).astype(np.int64).astype("timedelta64[us]"))


def write(source: Source, path: Path) -> dict[str, int]:
    collected: dict[str, list[Any]] = {"ROBOT_STATE": [], "WORLD_STATE": [], "ACTION_CHUNK": []}
    for event in source.messages(*collected):
        collected[event.channel].append(event.message)
    states, worlds, chunks = (_Series(part) for part in collected.values())
    with whole_or_not_at_all(path) as partial:
        recording = rr.RecordingStream("tandem", recording_id=str(path.stem), send_properties=False)
        recording.save(partial, default_blueprint=_blueprint())
        recording.send_recording_name(str(source.log))
        recording.log("scenario", rr.TextDocument(source.made_from.scenario_yaml), static=True)
        if states.messages:
            _arm(recording, states)
            _paths(recording, states)
            _forces(recording, states)
        for name, (channel, position, orientation) in FRAMES.items():
            series = states if channel == "ROBOT_STATE" else worlds
            if series.messages:
                _frame(recording, name, series, position, orientation)
        episodes = list(source.episodes())
        _chunks(recording, source, chunks.messages, worlds.messages, episodes)
        for axis in "xyz":
            for who in ("policy", "human", "executed"):
                look = rr.SeriesLines(colors=[COLORS[who]], names=[who])
                recording.log(f"action/{axis}/{who}", look, static=True)
        for episode in episodes:
            _episode(recording, episode, _step_times(source, episode))
        recording.flush()
        recording.disconnect()
    return {
        "episodes": len(source.ends),
        "robot_states": len(states.messages),
        "chunks": len(chunks.messages),
    }


def _step_times(source: Source, episode: Episode) -> Floats:
    """us, when each step began."""
    return episode.end.utime - 1e6 / source.policy_rate_hz * np.arange(episode.n_steps, 0, -1)


# ---- the scene


def _arm(recording: rr.RecordingStream, states: _Series) -> None:
    base = rr.Transform3D(parent_frame="tf#/world", child_frame=BASE_LINK)  # W is both
    recording.log("world/panda", base, static=True)
    for name, shape in shapes().items():
        link, _, _ = name.partition("/")
        recording.log(f"world/panda/covers/{name}", shape, rr.CoordinateFrame(link), static=True)
    q, half_width = states.array("q_measured"), 0.5 * states.array("gripper_width")
    for joint in UrdfTree.from_file_path(PANDA / "panda.urdf").joints():
        entity = f"world/panda/joints/{joint.name}"
        if joint.joint_type == "fixed":
            recording.log(entity, joint.compute_transform(0.0), static=True)
            continue
        values = half_width if joint.joint_type == "prismatic" else q[:, int(joint.name[-1]) - 1]
        columns = joint.compute_transform_columns(values.tolist(), clamp=False)
        rr.send_columns(entity, states.time, columns, recording=recording)


def shapes() -> dict[str, Any]:
    """`link/shape` -> the simulator's capsules, cylinders and boxes of the arm, in the frame of the link."""
    found: dict[str, Any] = {}
    for body in ElementTree.parse(PANDA / "panda.xml").getroot().iter("body"):
        for geom in body.findall("geom"):
            size = _numbers(geom.get("size", ""))
            material = "dark" if "finger" in str(body.get("name")) else geom.get("material", "cover")
            look: dict[str, Any] = {"colors": [COLORS[material]], "fill_mode": "solid"}
            name = f"{body.get('name')}/{geom.get('name')}"
            if geom.get("fromto") is None:
                center = _numbers(geom.get("pos", "0 0 0"))
                found[name] = rr.Boxes3D(centers=[center], half_sizes=[size], **look)
                continue
            start, end = _numbers(geom.get("fromto", "")).reshape(2, 3)
            length = float(np.linalg.norm(end - start))
            look |= {
                "lengths": [length],
                "radii": [size[0]],
                "quaternions": [_turn_z_to((end - start) / length)],
            }
            if geom.get("type") == "cylinder":
                found[name] = rr.Cylinders3D(centers=[0.5 * (start + end)], **look)
            else:
                found[name] = rr.Capsules3D(translations=[start], **look)
    return found


def _numbers(text: str) -> Floats:
    return np.array([float(word) for word in text.split()])


def _turn_z_to(direction: Floats) -> rr.Quaternion:
    """The shortest rotation that takes the z axis there."""
    w = 1.0 + direction[2]
    xyzw = np.array([1.0, 0, 0, 0]) if w < 1e-9 else np.array([-direction[1], direction[0], 0.0, w])
    return rr.Quaternion(xyzw=xyzw / np.linalg.norm(xyzw))


def _frame(
    recording: rr.RecordingStream, name: str, series: _Series, position: str, orientation: str
) -> None:
    entity = f"world/{name}"
    wxyz = series.array(orientation)
    recording.log(entity, rr.TransformAxes3D(0.03), static=True)
    columns = rr.Transform3D.columns(translation=series.array(position), quaternion=wxyz[:, [1, 2, 3, 0]])
    rr.send_columns(entity, series.time, columns, recording=recording)


def _paths(recording: rr.RecordingStream, states: _Series) -> None:
    episode = states.array("episode").astype(int)
    position, utime = states.array("p_WE_measured"), states.array("utime")
    numbers = [number for number in np.unique(episode) if number >= 0]
    strips = [position[episode == number] for number in numbers]
    starts = [utime[episode == number][0] for number in numbers]
    _send_strips(recording, "world/path", starts, strips, COLORS["path"])


def _send_strips(
    recording: rr.RecordingStream,
    entity: str,
    utime: Sequence[int],
    strips: list[Floats],
    color: tuple[int, int, int],
) -> None:
    """One line at a time, each until the next."""
    if not strips:
        return
    recording.log(entity, rr.LineStrips3D.from_fields(colors=[color], radii=[0.001]), static=True)
    columns = rr.LineStrips3D.columns(strips=[[strip] for strip in strips])
    rr.send_columns(entity, [time_column(utime)], columns, recording=recording)


# ---- forces and actions


def _forces(recording: rr.RecordingStream, states: _Series) -> None:
    force, bound = states.array("F_ext_W")[:, :3], states.array("force_bound_W")
    curves = {f"force/{axis}": force[:, column] for column, axis in enumerate("xyz")}
    curves |= {"force/norm": np.linalg.norm(force, axis=1), "force/bound_z": bound[:, 2]}
    curves["alpha"] = states.array("alpha")
    # a curve must not bridge the time between two episodes
    utime = states.array("utime")
    ends = np.flatnonzero(np.diff(states.array("episode"), append=np.nan))
    index = [time_column(np.insert(utime, ends + 1, utime[ends] + 1))]
    for entity, values in curves.items():
        scalars = rr.Scalars.columns(scalars=np.insert(values, ends + 1, np.nan))
        rr.send_columns(entity, index, scalars, recording=recording)
    recording.log("world/force", rr.Arrows3D.from_fields(colors=[COLORS["force"]]), static=True)
    columns = rr.Arrows3D.columns(origins=states.array("p_WE_measured"), vectors=METRES_PER_NEWTON * force)
    rr.send_columns("world/force", states.time, columns, recording=recording)


def _chunks(
    recording: rr.RecordingStream,
    source: Source,
    chunks: Iterable[Any],
    worlds: Iterable[Any],
    episodes: list[Episode],
) -> None:
    """Lines of tool positions from the commanded pose at which a chunk took over.

    Both add up translations alone, in the task's limit per step: what the policy asked for, and what was made of the
    same steps by the person, the limits and the next chunk.
    """
    limit = float(source.scenario["task"]["translation_limit_m"])
    ticks_per_step = 1000 // source.policy_rate_hz
    start_of = {(world.episode, world.step): np.array(world.p_WE_commanded) for world in worlds}
    executed_of = {episode.number: episode.executed_action[:, :3] for episode in episodes}
    utime, predicted, executed = [], [], []
    for chunk in chunks:
        step = chunk.start_tick // ticks_per_step
        start = start_of.get((chunk.episode, step))
        done = executed_of.get(chunk.episode)
        if start is None or done is None:
            continue
        asked = np.array(chunk.policy_chunk)[:, :3]
        utime.append(chunk.utime)
        predicted.append(_way(start, limit * asked))
        executed.append(_way(start, limit * done[step : step + chunk.horizon]))
    _send_strips(recording, "world/chunk/predicted", utime, predicted, COLORS["policy"])
    _send_strips(recording, "world/chunk/executed", utime, executed, COLORS["executed"])


def _way(start: Floats, moves: Floats) -> Floats:
    return start + np.vstack([np.zeros((1, 3)), np.cumsum(moves, axis=0)])


def _episode(recording: rr.RecordingStream, episode: Episode, utime: Floats) -> None:
    if not episode.n_steps:
        return
    end_utime = episode.end.utime
    index = [time_column(np.append(utime, end_utime))]
    actions = {
        "policy": episode.policy_action,
        "human": episode.human_action,
        "executed": episode.executed_action,
    }
    for who, action in actions.items():
        for column, axis in enumerate("xyz"):
            scalars = rr.Scalars.columns(scalars=np.append(action[:, column], np.nan))
            rr.send_columns(f"action/{axis}/{who}", index, scalars, recording=recording)
    changes = np.flatnonzero(np.diff(episode.intervention, prepend=~episode.intervention[:1]))
    driver = ["human" if episode.intervention[step] else "policy" for step in changes]
    columns = rr.StateChange.columns(state=[*driver, "between episodes"])
    rr.send_columns(
        "driver", [time_column(np.append(utime[changes], end_utime))], columns, recording=recording
    )
    human = int(episode.intervention.sum())
    name = f"episode {episode.number}"
    words = f"{name} ({episode.phase}): {episode.outcome}, {episode.n_steps} steps, {human} by the human"
    texts = [words, f"end of {name}: {episode.outcome}"]
    rr.send_columns(
        "episode",
        [time_column([utime[0], end_utime])],
        rr.TextLog.columns(text=texts, level=["INFO", "INFO" if episode.outcome == "success" else "WARN"]),
        recording=recording,
    )


def _blueprint() -> rrb.Blueprint:
    eye = rrb.EyeControls3D(position=[1.2, -1.0, 0.7], look_target=[0.35, 0.0, 0.25], eye_up=[0, 0, 1])
    curves = [rrb.TimeSeriesView(origin="force", name="force [N]")]
    curves += [rrb.TimeSeriesView(origin=f"action/{axis}", name=f"action {axis}") for axis in "xyz"]
    curves += [rrb.TimeSeriesView(origin="alpha", name="authority of the human")]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial3DView(origin="world", name="arm", eye_controls=eye),
                rrb.StateTimelineView(origin="driver", name="who drives"),
                rrb.TextLogView(origin="episode", name="episodes"),
                row_shares=[5, 1, 2],
            ),
            rrb.Vertical(*curves),
        ),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )
