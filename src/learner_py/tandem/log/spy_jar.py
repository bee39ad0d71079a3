"""The jar of message types that lcm-spy wants: `./tandem log spy-jar`.

lcm-spy is LCM's own viewer, a Java program; it shows the fields of a type only when a jar with the type's Java class is
on its CLASSPATH. Everything else of Tandem needs no Java.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from tandem.run_folder import ROOT, RunFolderError

PROGRAMS = ("java", "javac", "jar")


def lcm_program(name: str) -> Path:
    """A program of the lcm wheel, e.g. lcm-logger."""
    return Path(sys.executable).parent / name


def lcm_jars() -> list[Path]:
    """lcm.jar and what lcm-spy itself is made of."""
    import lcm

    folder = Path(lcm.__file__).parents[1] / "share" / "java"
    return sorted(jar for jar in folder.glob("*.jar") if "sources" not in jar.name)


def missing(path: str | None = None) -> str | None:
    """A sentence when there is no Java to build with on PATH (or on `path`), else None."""
    absent = [name for name in PROGRAMS if shutil.which(name, path=path) is None]
    if not absent:
        return None
    return (
        f"{', '.join(absent)} not found; as root: apt-get install default-jdk-headless. "
        "Without Java: ./tandem spy, which shows more."
    )


def build(out: Path) -> Path:
    """Writes the jar. Raises RunFolderError with a sentence when Java is missing or refuses."""
    if sentence := missing():
        raise RunFolderError(sentence)
    with tempfile.TemporaryDirectory(prefix="tandem-jar-") as name:
        folder = Path(name)
        classpath = ":".join(map(str, lcm_jars()))
        types = sorted(map(str, (ROOT / "lcm_types").glob("*.lcm")))
        _run([str(lcm_program("lcm-gen")), "--java", "--jpath", str(folder / "java"), *types])
        sources = sorted(map(str, (folder / "java").rglob("*.java")))
        _run(
            [
                "javac",
                "-J-XX:TieredStopAtLevel=1",
                "-proc:none",
                "-nowarn",
                "-cp",
                classpath,
                "-d",
                str(folder / "classes"),
                *sources,
            ]
        )
        _run(["jar", "cf", str(folder / "types.jar"), "-C", str(folder / "classes"), "."])
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(folder / "types.jar", out)
        except OSError as error:
            raise RunFolderError(f"{out} can't be written ({error.strerror}).") from None
    return out


def _run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        said = (done.stderr or done.stdout).strip().splitlines()
        raise RunFolderError(f"{command[0]} failed: {said[-1] if said else f'exit code {done.returncode}'}.")
