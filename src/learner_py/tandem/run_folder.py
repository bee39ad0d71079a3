"""Where things lie: the tree, the built programs, and the folder of one run."""

import fcntl
import json
import os
import platform
import re
import struct
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

ROOT = Path(__file__).resolve().parents[3]
CONFIG = ROOT / "config"
RUNS = ROOT / "runs"


def program(name: str) -> Path:
    """A built program; TANDEM_BIN points to another folder of programs."""
    return Path(os.environ.get("TANDEM_BIN") or ROOT / "build" / "bin").absolute() / name


class RunFolderError(Exception):
    """A sentence about a run folder that can't be used."""


@dataclass(frozen=True)
class RunFolder:
    """Names of everything in RUN/."""

    path: Path

    @property
    def scenario(self) -> Path:
        return self.path / "scenario.yaml"

    @property
    def log(self) -> Path:
        return self.path / "log.lcm"

    @property
    def summary(self) -> Path:
        return self.path / "summary.json"

    @property
    def policy(self) -> Path:
        """The selected policy."""
        return self.path / "policy.safetensors"

    @property
    def evaluations(self) -> Path:
        return self.path / "evaluations"

    @property
    def clock(self) -> Path:
        """Wall times of the run's parts, kept over interruptions."""
        return self.path / "clock.json"

    @property
    def progress(self) -> Path:
        """LEARNER_STATUS over the run, one line a report."""
        return self.path / "progress.csv"

    @property
    def tensorboard(self) -> Path:
        """The same and more as TensorBoard event files."""
        return self.path / "tensorboard"

    @property
    def report(self) -> Path:
        """All of the run on one page for a browser."""
        return self.path / "report.html"

    @property
    def progress_text(self) -> Path:
        """What a training says while a person has its terminal."""
        return self.path / "train.out"

    @property
    def buffer(self) -> Path:
        """Digest of the learner's buffer when it ended: {episodes_trained_through, steps, sha256}."""
        return self.path / "learner" / "buffer.json"

    @property
    def lcm_url(self) -> Path:
        """The LCM address of the run, there while it is going."""
        return self.path / "lcm_url"

    def checkpoints(self) -> dict[int, Path]:
        """env_steps -> policy file, ascending."""
        found = {}
        for file in (self.path / "checkpoints").glob("policy_at_*.safetensors"):
            if match := re.fullmatch(r"policy_at_(\d+)\.safetensors", file.name):
                found[int(match[1])] = file
        return dict(sorted(found.items()))

    def policies(self) -> dict[int, Path]:
        """Version -> policy file, of those that are still on disk."""
        found = {}
        for file in (self.path / "policies").glob("policy_*.safetensors"):
            if match := re.fullmatch(r"policy_(\d+)\.safetensors", file.name):
                found[int(match[1])] = file
        return found

    def evaluation(self, env_steps: int) -> Path:
        return self.evaluations / f"{env_steps:07d}.json"

    def lock(self) -> IO[str]:
        """Keeps a second supervisor out of this folder for as long as the file is open."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        # Beside the folder, so that it stays in force when the folder is set aside.
        file = self.path.with_name(f".{self.path.name}.lock").open("a")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            file.close()
            raise RunFolderError(
                f"{self.path} is in use by another call; wait for it, or give another folder by --run."
            ) from None
        return file

    def set_aside(self) -> Path:
        """Moves the folder to the first free name RUN.old-N; nothing is deleted."""
        n = 1
        while (aside := self.path.with_name(f"{self.path.name}.old-{n}")).exists():
            n += 1
        self.path.rename(aside)
        return aside


def default_run(task: str, method: str, seed: int) -> Path:
    return RUNS / f"{task}-{method}-seed{seed}"


def shown(path: Path) -> str:
    """A path as a person in the present folder would type it."""
    try:
        return str(path.resolve().relative_to(Path.cwd()))
    except ValueError:
        return str(path)


def write_json(path: Path, value: Any) -> None:
    """Writes JSON whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".part")
    partial.write_text(json.dumps(value, indent=2) + "\n", encoding="utf-8")
    partial.replace(path)


def policy_metadata(path: Path) -> dict[str, str]:
    """The string map in the head of a policy file."""
    try:
        with path.open("rb") as file:
            (length,) = struct.unpack("<Q", file.read(8))
            if length > 16 << 20:
                raise ValueError("its header would be larger than 16 MB")
            metadata = json.loads(file.read(length))["__metadata__"]
            if metadata["format"] != "tandem-policy-1":
                raise ValueError(f"its format is {metadata['format']!r}")
            return metadata
    except OSError as error:
        raise RunFolderError(f"{shown(path)} can't be read ({error.strerror}).") from None
    except (ValueError, KeyError, TypeError, struct.error) as error:
        raise RunFolderError(f"{shown(path)} is not a policy file of Tandem ({error}).") from None


def git_revision() -> str:
    """Revision of the tree, `-dirty` with local changes; `unknown` outside of git."""
    try:
        return subprocess.run(
            ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--abbrev=12"],
            capture_output=True,
            text=True,
            check=True,
            timeout=10,
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return "unknown"


def host() -> dict[str, Any]:
    """What a figure was measured on."""
    cpu = "unknown"
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        cpu = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return {"cpu": cpu, "cores": len(os.sched_getaffinity(0)), "system": platform.platform()}
