"""Demonstrations from elsewhere: what LeRobot wrote, what we exported, and a run that begins with them."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from small_run import compose, invoke, train

from tandem import demonstrations
from tandem.export.source import open_source
from tandem.learner.episode import Episode
from tandem.log import episodes, messages
from tandem.run_folder import RunFolder

READER = Path(__file__).with_name("lerobot_reader.py")
OBSERVATION = compose().data["task"]["observation"]


@pytest.fixture(scope="module")
def exported(run: RunFolder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("dataset") / "set"
    code, output = invoke("export", "lerobot", run.path, "--out", out, "--phase", "demonstration")
    assert code == 0, output
    return out


def imported(dataset: Path, out: Path, *options: str) -> list[Episode]:
    code, output = invoke("import", "lerobot", dataset, "--out", out, "--method", "mcbc", *options)
    assert code == 0, output
    return list(episodes(out))


def test_export_and_import_give_the_demonstrations_back(
    run: RunFolder, exported: Path, tmp_path: Path
) -> None:
    given = demonstrations.successful(run.log)
    back = imported(exported, tmp_path / "log.lcm")
    assert len(back) == len(given) == 2
    for one, other in zip(given, back, strict=True):
        for name in ("observation", "next_observation", "executed_action", "human_action", "reward", "alpha"):
            assert np.array_equal(getattr(one, name), getattr(other, name)), name
        assert np.array_equal(one.discounted_return, other.discounted_return)
        assert np.array_equal(one.terminated, other.terminated)
        assert other.is_demonstration and other.is_learnable


def test_run_goes_on_from_imported_demonstrations(exported: Path, tmp_path: Path) -> None:
    """The real controller takes them for its own: no demonstration by the operator, training from episode 2 on."""
    imported(exported, tmp_path / "log.lcm")
    folder = RunFolder(tmp_path / "run")
    setting = compose("run.env_steps=5")
    demonstrations.begin(folder.log, setting, tmp_path / "log.lcm")
    train(folder, setting)
    source = open_source(folder.log)
    phases = [episode.phase for episode in source.episodes()]
    assert phases[:2] == ["demonstration"] * 2 and set(phases[2:]) == {"training"}
    states = [event.message.episode for event in messages(folder.log, "ROBOT_STATE")]
    assert min(number for number in states if number >= 0) == 2
    buffer = json.loads(folder.buffer.read_text())
    assert buffer["steps"] == sum(episode.n_steps for episode in source.episodes())


def test_dataset_that_lerobot_wrote_is_read_by_name(lerobot_python: Path, tmp_path: Path) -> None:
    generator = np.random.default_rng(0)
    state_names, action_names = [*OBSERVATION[::-1], "battery"], ["rz", "x", "gripper", "y", "z"]
    given = {
        "state": generator.normal(size=(11, len(state_names))).astype(np.float32),
        "action": generator.uniform(-1, 1, size=(11, 5)).astype(np.float32),
        "episode": np.array([0] * 5 + [1] * 6),
    }
    names = {"observation.state": state_names, "action": action_names}
    np.savez(tmp_path / "in.npz", names=json.dumps(names), **given)
    command = [lerobot_python, READER, "write", tmp_path / "set", tmp_path / "in.npz"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-3000:]

    first, second = imported(tmp_path / "set", tmp_path / "log.lcm")
    assert (first.n_steps, second.n_steps) == (5, 6)
    assert np.array_equal(first.observation, given["state"][:5, -2::-1])
    assert np.array_equal(first.next_observation[:-1], first.observation[1:])
    assert np.array_equal(second.executed_action[:, [5, 0, 6, 1, 2]], given["action"][5:])
    assert not second.executed_action[:, [3, 4]].any()
    assert second.reward.tolist() == [0, 0, 0, 0, 0, 1] and second.terminated.tolist() == [False] * 5 + [True]


def test_unsuccessful_episodes_are_left_out_and_told(exported: Path, tmp_path: Path) -> None:
    changed(exported, tmp_path / "set", "next.success", lambda column, index: column & (index != 0))
    code, output = invoke("import", "lerobot", tmp_path / "set", "--out", tmp_path / "log.lcm")
    assert code == 0 and "1 demonstrations" in output and "1 episodes without success were left out" in output


def test_what_is_not_of_the_task_is_refused_with_a_sentence(exported: Path, tmp_path: Path) -> None:
    def refusal(dataset: Path, *options: object) -> str:
        code, output = invoke("import", "lerobot", dataset, "--out", tmp_path / "log.lcm", *options)
        assert code != 0 and "Traceback" not in output and not (tmp_path / "log.lcm").exists()
        return output

    assert "is no LeRobotDataset: meta/info.json is missing" in refusal(tmp_path)
    changed(exported, tmp_path / "wide", "action", lambda column, index: 3 * np.ones_like(column))
    assert "action x of episode 0, frame 0 is 3; it must be in [-1, 1]" in refusal(tmp_path / "wide")
    changed(exported, tmp_path / "failed", "next.success", lambda column, index: column & False)
    assert "holds no successful episode" in refusal(tmp_path / "failed")
    for file, key, value, sentence in (
        ("rate", "fps", 30, "has 30 frames a second, and the policy runs at 10 Hz"),
        ("old", "codebase_version", "v2.1", "is a LeRobotDataset v2.1; v3.0 is read"),
        ("bare", "features", {}, "observation.state does not name tool_z"),
    ):
        changed(exported, tmp_path / file, "next.success", lambda column, index: column)
        info = json.loads((exported / "meta/info.json").read_text())
        (tmp_path / file / "meta/info.json").write_text(json.dumps(info | {key: value}))
        assert sentence in refusal(tmp_path / file)


def changed(dataset: Path, copy: Path, name: str, change) -> None:
    """A copy of the dataset with one column made anew by change(array, episode_index)."""
    (copy / "meta").mkdir(parents=True)
    (copy / "meta/info.json").write_bytes((dataset / "meta/info.json").read_bytes())
    file = "data/chunk-000/file-000.parquet"
    table = pq.read_table(dataset / file)
    column = np.array(table[name].to_pylist())
    made = change(column, table["episode_index"].to_numpy())
    position = table.column_names.index(name)
    table = table.set_column(
        position, table.schema.field(name), pa.array(made.tolist(), table.schema.field(name).type)
    )
    (copy / file).parent.mkdir(parents=True)
    pq.write_table(table, copy / file)


def test_no_more_demonstrations_are_taken_than_the_run_asks_for(run: RunFolder, tmp_path: Path) -> None:
    demonstrations.begin(tmp_path / "log.lcm", compose("run.demonstrations=1"), run.log)
    assert [episode.number for episode in episodes(tmp_path / "log.lcm")] == [0]


def test_demonstrations_get_the_returns_of_the_runs_own_discount(run: RunFolder, tmp_path: Path) -> None:
    demonstrations.begin(tmp_path / "log.lcm", compose("method.discount=0.5"), run.log)
    first = next(episodes(tmp_path / "log.lcm"))
    np.testing.assert_allclose(first.discounted_return[::-1], 0.5 ** np.arange(first.n_steps), rtol=1e-6)
