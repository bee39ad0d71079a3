"""What `./tandem export` writes, opened by the programs that it is for, and compared with the log value by value."""

import base64
import json
import subprocess
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
import rerun as rr
from mcap.reader import make_reader
from rerun.chunk import RrdReader
from small_run import invoke
from tandem_lcm.tandem.episode_step_t import episode_step_t

from tandem.export import mcap
from tandem.export.message import json_schema
from tandem.export.source import Source
from tandem.learner.episode import ACTION_AXES, Episode
from tandem.log import messages
from tandem.log.fields import as_json
from tandem.run_folder import RunFolder
from tandem.wire import CHANNELS

READER = Path(__file__).with_name("lerobot_reader.py")


def export(kind: str, run: RunFolder, out: Path, *options: str) -> Path:
    code, output = invoke("export", kind, run.path, "--out", out, *options)
    assert code == 0, output
    return out


def column(episodes: list[Episode], name: str) -> np.ndarray:
    return np.concatenate([getattr(episode, name) for episode in episodes])


# ---- LeRobot


def test_lerobots_own_reader_gives_the_steps_of_the_log(
    run: RunFolder, episodes: list[Episode], lerobot_python: Path, tmp_path: Path
) -> None:
    dataset = export("lerobot", run, tmp_path / "set", "--instruction", "Put the peg into the hole.")
    command = [lerobot_python, READER, "read", dataset, tmp_path / "read.npz"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-3000:]
    read = np.load(tmp_path / "read.npz")
    facts = json.loads(str(read["facts"]))

    state = column(episodes, "observation")
    assert np.array_equal(read["observation.state"], state)
    assert np.array_equal(read["next.observation.state"], column(episodes, "next_observation"))
    for name, kept in {
        "is_intervention": "intervention",
        "human_authority": "alpha",
        "policy_action": "policy_action",
        "human_action": "human_action",
        "policy_version": "policy_version",
        "discounted_return": "discounted_return",
    }.items():
        assert np.array_equal(read[f"complementary_info.{name}"], column(episodes, kept)), name
    assert 0 < read["complementary_info.is_intervention"].mean() < 1
    assert np.array_equal(read["next.reward"], column(episodes, "reward"))
    assert read["next.done"].sum() == len(episodes)
    assert read["next.success"].sum() == sum(episode.outcome == "success" for episode in episodes)

    # chunks by LeRobot's delta_timestamps: never from another episode
    first = 0
    for episode in episodes:
        for t in range(episode.n_steps):
            valid = min(4, episode.n_steps - t)
            chunk = read["action"][first + t]
            assert np.array_equal(chunk[:valid], episode.executed_action[t : t + valid])
            assert read["action_is_pad"][first + t].tolist() == [k >= valid for k in range(4)]
        first += episode.n_steps

    assert facts["tasks"] == ["Put the peg into the hole."]
    assert facts["lengths"] == [episode.n_steps for episode in episodes]
    assert facts["outcomes"] == [episode.outcome for episode in episodes]
    assert facts["batch"] == [3, state.shape[1]] and facts["third"] == [2]
    assert facts["names"][0] == "tool_z"
    np.testing.assert_allclose(facts["mean"], state.mean(axis=0, dtype=float), atol=1e-9)


def test_full_data_files_are_followed_by_others(
    run: RunFolder, episodes: list[Episode], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tandem.export.lerobot.FILE_MB", 0)  # one episode a file
    monkeypatch.setattr("tandem.export.lerobot.FILES_PER_CHUNK", 2)
    dataset = export("lerobot", run, tmp_path / "set")
    rows = pq.read_table(dataset / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for row, episode in zip(rows, episodes, strict=True):
        place = f"data/chunk-{row['data/chunk_index']:03d}/file-{row['data/file_index']:03d}.parquet"
        file = pq.read_table(dataset / place)
        assert set(file["episode_index"].to_pylist()) == {row["episode_index"]}
        assert file.num_rows == episode.n_steps


# ---- MCAP


def test_image_of_a_step_is_base64_in_json_and_for_foxglove() -> None:
    step = episode_step_t()
    step.image, step.n_image = (
        bytes(range(256)),
        256,
    )  # among them what standard and URL-safe base64 write differently
    value = json.loads(as_json(step))
    assert base64.b64decode(value["image"], validate=True) == step.image and value["next_image"] == ""
    jsonschema.validate(value, json_schema("episode_step_t"))
    seen = json.loads(mcap._image(step.image, 1_500_000_000))
    assert base64.b64decode(seen["data"], validate=True) == step.image
    assert seen["timestamp"] == {"sec": 1, "nsec": 500_000_000} and seen["format"] == "jpeg"


def test_mcaps_reader_gives_every_message_and_its_schema_holds(run: RunFolder, tmp_path: Path) -> None:
    expected = list(messages(run.log))
    with export("mcap", run, tmp_path / "log.mcap").open("rb") as file:
        reader = make_reader(file)
        read = [item for item in reader.iter_messages(log_time_order=False) if item[1].topic != "tf"]
        summary = reader.get_summary()
        (attachment,) = reader.iter_attachments()
    assert [channel.topic for _, channel, _ in read] == [event.channel for event in expected]
    validators: dict[str, Any] = {}
    for event, (schema, channel, message) in zip(expected, read, strict=True):
        assert schema is not None and (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
        assert schema.name == f"tandem.{CHANNELS[event.channel].__name__}"
        assert message.log_time == 1000 * event.timestamp
        value = json.loads(message.data)
        assert value["utime"] == event.message.utime
        if event.channel not in validators:
            meaning = json.loads(schema.data)
            jsonschema.Draft202012Validator.check_schema(meaning)
            validators[event.channel] = jsonschema.Draft202012Validator(
                meaning | {"additionalProperties": False}
            )
            validators[event.channel].validate(value)
        if event.channel == "ROBOT_STATE":
            assert value["q_measured"] == list(event.message.q_measured)
    assert set(validators) >= {"SCENARIO", "ROBOT_STATE", "ACTION_CHUNK", "EPISODE_STEP", "EPISODE_END"}
    assert summary is not None and summary.statistics is not None
    assert summary.statistics.message_count > len(expected)
    assert b"name: peg" in attachment.data


def test_schema_tells_unit_and_frame() -> None:
    from tandem.export.message import json_schema

    force = json_schema("robot_state_t")["properties"]["F_ext_W"]
    assert force["minItems"] == force["maxItems"] == 6 and force["items"] == {"type": "number"}
    assert force["description"].startswith("N, N m: force then moment on the tool")
    records = json_schema("controller_fault_t")["properties"]["last_records"]
    assert records["items"]["properties"]["tick"]["type"] == "integer"


def test_frames_for_foxglove_are_the_poses_of_the_log(run: RunFolder, tmp_path: Path) -> None:
    states = [event.message for event in messages(run.log, "ROBOT_STATE")]
    with export("mcap", run, tmp_path / "log.mcap").open("rb") as file:
        frames = list(make_reader(file).iter_messages(topics=["tf"]))
    schema, _, _ = frames[0]
    assert schema is not None and schema.name == "foxglove.FrameTransforms"
    poses = [pose for _, _, message in frames for pose in json.loads(message.data)["transforms"]]
    tool = [pose for pose in poses if pose["child_frame_id"] == "tool"]
    assert len(tool) == len(states)
    for pose, state in list(zip(tool, states, strict=True))[:: len(states) // 20]:
        assert list(pose["translation"].values()) == list(state.p_WE_measured)
        w, x, y, z = state.q_WE_measured
        assert pose["rotation"] == {"x": x, "y": y, "z": z, "w": w}
        assert 10**6 * pose["timestamp"]["sec"] + pose["timestamp"]["nsec"] // 1000 == state.utime


# ---- Rerun


@pytest.fixture(scope="module")
def recording(run: RunFolder, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Entity -> its rows as Rerun's reader gives them, with the times in us."""
    path = export("rerun", run, tmp_path_factory.mktemp("rerun") / "log.rrd")
    reader = RrdReader(path)
    assert len(reader.recordings()) == 1 and len(reader.blueprints()) == 1
    rows: dict[str, Any] = {}
    for chunk in reader.stream().to_chunks():
        batch = chunk.to_record_batch()
        entity = rows.setdefault(chunk.entity_path, {})
        for name, array in zip(batch.schema.names, batch.columns, strict=True):
            if name == "sim_time":
                entity.setdefault(name, []).extend(array.cast("int64").to_numpy() // 1000)
            elif name != "rerun.controls.RowId":
                entity.setdefault(name, []).extend(array.to_pylist())
    return rows


def test_arm_in_rerun_stands_where_the_robot_said(run: RunFolder, recording: dict[str, Any]) -> None:
    """Chains the joints as a viewer does: the tool comes out at the measured pose."""
    states = [event.message for event in messages(run.log, "ROBOT_STATE")]
    joints = {name: rows for name, rows in recording.items() if name.startswith("/world/panda/joints/")}
    parents = {}
    for rows in joints.values():
        (child,), (parent,) = rows["Transform3D:child_frame"][0], rows["Transform3D:parent_frame"][0]
        parents[child] = (parent, rows)
    for index in range(0, len(states), len(states) // 15):
        link, pose = "tool", np.eye(4)
        while link != "link0":
            link, rows = parents[link]
            row = index if len(rows["Transform3D:translation"]) > 1 else 0
            step = np.eye(4)
            step[:3, :3] = rotation(rows["Transform3D:quaternion"][row][0])
            step[:3, 3] = rows["Transform3D:translation"][row][0]
            pose = step @ pose
        np.testing.assert_allclose(pose[:3, 3], states[index].p_WE_measured, atol=2e-5)
        w, *imaginary = states[index].q_WE_measured
        np.testing.assert_allclose(pose[:3, :3], rotation([*imaginary, w]), atol=2e-5)
    base = recording["/world/panda"]
    assert base["Transform3D:parent_frame"] == [["tf#/world"]] and base["Transform3D:child_frame"] == [
        ["link0"]
    ]
    covers = [name for name in recording if name.startswith("/world/panda/covers/link")]
    assert len(covers) >= 11


def rotation(xyzw: Any) -> np.ndarray:
    x, y, z, w = xyzw
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_rerun_shows_forces_chunks_and_who_drives(
    run: RunFolder, source: Source, episodes: list[Episode], recording: dict[str, Any]
) -> None:
    states = [event.message for event in messages(run.log, "ROBOT_STATE")]
    force = np.array([value for (value,) in recording["/force/z"]["Scalars:scalars"]])
    assert np.isnan(force).sum() == len(episodes)  # curves are cut between episodes
    np.testing.assert_allclose(force[~np.isnan(force)], [state.F_ext_W[2] for state in states])
    times = np.array(recording["/force/z"]["sim_time"])
    assert times[~np.isnan(force)].tolist() == [state.utime for state in states]

    chunks = [event.message for event in messages(run.log, "ACTION_CHUNK")]
    limit = source.scenario["task"]["translation_limit_m"]
    predicted = rows_of(recording["/world/chunk/predicted"], "LineStrips3D:strips")
    executed = rows_of(recording["/world/chunk/executed"], "LineStrips3D:strips")
    assert len(predicted) == len(executed) == len(chunks) > 20
    by_number = {episode.number: episode for episode in episodes}
    for chunk, asked, done in zip(chunks, predicted, executed, strict=True):
        asked, done = np.array(asked[0]), np.array(done[0])
        assert asked.shape == (chunk.horizon + 1, 3) and np.array_equal(asked[0], done[0])
        np.testing.assert_allclose(
            np.diff(asked, axis=0), limit * np.array(chunk.policy_chunk)[:, :3], atol=1e-6
        )
        first = by_number[chunk.episode].executed_action[chunk.start_tick // 100, :3]
        np.testing.assert_allclose(done[1] - done[0], limit * first, atol=1e-6)

    drivers = {state for (state,) in recording["/driver"]["StateChange:state"]}
    assert drivers == {"human", "policy", "between episodes"}
    words = [text for (text,) in recording["/episode"]["TextLog:text"]]
    assert sum(word.startswith("end of episode") for word in words) == len(episodes)


def rows_of(rows: dict[str, Any], name: str) -> list[Any]:
    return [value for value in rows[name] if value]


def test_rerun_itself_opens_the_mcap_and_the_lerobot_export(run: RunFolder, tmp_path: Path) -> None:
    for kind, name in (("mcap", "log.mcap"), ("lerobot", "set")):
        path = export(kind, run, tmp_path / name, "--episodes", "0-2")
        recording = rr.RecordingStream("test")
        recording.save(tmp_path / f"{kind}.rrd")
        recording.log_file_from_path(path)
        recording.flush()
        recording.disconnect()
        reader = RrdReader(tmp_path / f"{kind}.rrd")
        stores = [reader.stream(store=store) for store in reader.recordings()]
        entities = {chunk.entity_path for store in stores for chunk in store.to_chunks()}
        wanted = "/ROBOT_STATE" if kind == "mcap" else "/observation.state"
        assert any(wanted in entity for entity in entities), sorted(entities)[:40]


# ---- tables


def test_tables_hold_every_step_with_the_facts_of_its_episode(
    run: RunFolder, episodes: list[Episode], tmp_path: Path
) -> None:
    parquet = pq.read_table(export("parquet", run, tmp_path / "steps.parquet"))
    csv = pyarrow.csv.read_csv(export("csv", run, tmp_path / "steps.csv"))
    assert parquet.column_names == csv.column_names
    for table in (parquet, csv):
        assert table["episode"].to_pylist() == [e.number for e in episodes for _ in range(e.n_steps)]
        assert table["outcome"].to_pylist() == [e.outcome for e in episodes for _ in range(e.n_steps)]
        for axis, name in enumerate(ACTION_AXES):
            given = column(episodes, "executed_action")[:, axis]
            assert np.array_equal(table[f"executed_action.{name}"].to_numpy().astype(np.float32), given)
        assert np.array_equal(table["intervention"].to_numpy(), column(episodes, "intervention"))
        observed = [name for name in table.column_names if name.startswith("observation.")]
        for index in (0, observed.index("observation.goal_z")):
            given = column(episodes, "observation")[:, index]
            assert np.array_equal(table[observed[index]].to_numpy().astype(np.float32), given)


def test_table_of_a_channel_has_a_row_a_message(run: RunFolder, tmp_path: Path) -> None:
    states = [event.message for event in messages(run.log, "ROBOT_STATE") if event.message.episode == 1]
    options = ("--channel", "ROBOT_STATE", "--episodes", "1")
    table = pyarrow.csv.read_csv(export("csv", run, tmp_path / "states.csv", *options))
    assert table["tick"].to_pylist() == [state.tick for state in states]
    assert table["q_measured.6"].to_pylist() == [state.q_measured[6] for state in states]
    chunks = pq.read_table(export("parquet", run, tmp_path / "chunks.parquet", "--channel", "ACTION_CHUNK"))
    first = next(messages(run.log, "ACTION_CHUNK")).message
    assert json.loads(chunks["policy_chunk"][0].as_py()) == [list(row) for row in first.policy_chunk]


# ---- selection and refusals


def test_only_the_chosen_episodes_are_exported(
    run: RunFolder, source: Source, episodes: list[Episode], tmp_path: Path
) -> None:
    training = [episode.number for episode in episodes if episode.phase == "training"]
    table = pq.read_table(export("parquet", run, tmp_path / "a.parquet", "--phase", "training"))
    assert sorted(set(table["episode"].to_pylist())) == training
    with export("mcap", run, tmp_path / "b.mcap", "--episodes", "1,3-3").open("rb") as file:
        read = [(channel.topic, json.loads(m.data)) for _, channel, m in make_reader(file).iter_messages()]
    assert {value["episode"] for _, value in read if "episode" in value} == {1, 3}
    assert {value["episode_answered"] for topic, value in read if topic == "TELEOP_COMMAND"} == {1, 3}


def test_what_cannot_be_exported_is_refused_with_a_sentence(run: RunFolder, tmp_path: Path) -> None:
    (tmp_path / "there").touch()
    for options, sentence in {
        ("csv", run.path, "--episodes", "90"): "and none for --episodes 90",
        ("csv", run.path, "--episodes", "3-"): "there.csv",
        ("csv", run.path, "--episodes", "x"): "--episodes x: x is no range",
        ("csv", run.path, "--phase", "play"): "--phase is play; it must be one of",
        ("csv", run.path, "--channel", "NONE"): "--channel is NONE; it must be one of SCENARIO",
        ("mcap", run.path, "--channel", "ROBOT_STATE"): "--channel is for csv and parquet",
        ("csv", tmp_path / "none.lcm"): "does not exist",
        ("csv", run.path, "--out", tmp_path / "there"): "exists; give another --out",
    }.items():
        words = options if "--out" in options else (*options, "--out", tmp_path / "there.csv")
        code, output = invoke("export", *words)
        assert (code == 0) == (sentence == "there.csv") and sentence in output, output
        assert "Traceback" not in output
    assert not list(tmp_path.glob(".*part"))
