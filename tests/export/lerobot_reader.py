"""Run by the Python that has LeRobot's own dataset code (not Tandem): reads a dataset, or writes one.

lerobot_reader.py read DATASET OUT.npz      every frame as LeRobot gives it, and chunks by delta_timestamps
lerobot_reader.py write DATASET IN.npz      a dataset of the arrays state, action, episode, by LeRobot's own writer
"""

import json
import os
import sys
from pathlib import Path

os.environ["HF_HUB_OFFLINE"] = "1"
import numpy as np
from ledataset.datasets.lerobot_dataset import LeRobotDataset, LeRobotDatasetMetadata
from torch.utils.data import DataLoader


def read(root, out):
    meta = LeRobotDatasetMetadata("tandem/test", root=root)
    horizon = {"action": [step / meta.fps for step in range(4)]}
    dataset = LeRobotDataset("tandem/test", root=root, delta_timestamps=horizon)
    frames = [dataset[index] for index in range(len(dataset))]
    numbers = [key for key, value in frames[0].items() if hasattr(value, "numpy")]
    arrays = {key: np.stack([frame[key].numpy() for frame in frames]) for key in numbers}
    batch = next(iter(DataLoader(dataset, batch_size=3)))
    third = LeRobotDataset("tandem/test", root=root, episodes=[2])
    facts = {
        "tasks": sorted({frame["task"] for frame in frames}),
        "episodes": dataset.num_episodes,
        "lengths": [int(row["length"]) for row in meta.episodes],
        "ranges": [[int(row["dataset_from_index"]), int(row["dataset_to_index"])] for row in meta.episodes],
        "outcomes": [row["tandem/outcome"] for row in meta.episodes],
        "batch": list(batch["observation.state"].shape),
        "third": sorted({int(third[index]["episode_index"]) for index in range(len(third))}),
        "mean": meta.stats["observation.state"]["mean"].tolist(),
        "names": meta.names["observation.state"],
    }
    np.savez(out, facts=json.dumps(facts), **arrays)


def write(root, source):
    given = np.load(source)
    names = json.loads(str(given["names"]))
    features = {
        key: {"dtype": "float32", "shape": (len(names[key]),), "names": names[key]}
        for key in ("observation.state", "action")
    }
    dataset = LeRobotDataset.create("tandem/test", fps=10, features=features, root=root, use_videos=False)
    for episode in np.unique(given["episode"]):
        for row in np.flatnonzero(given["episode"] == episode):
            frame = {"observation.state": given["state"][row], "action": given["action"][row]}
            dataset.add_frame(frame | {"task": "put the peg into the hole"})
        dataset.save_episode()
    dataset.finalize()


if __name__ == "__main__":
    {"read": read, "write": write}[sys.argv[1]](Path(sys.argv[2]), sys.argv[3])
