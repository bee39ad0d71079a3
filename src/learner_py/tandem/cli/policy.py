"""`tandem policy ...`: look at a policy file, evaluate it, make one from LeRobot's checkpoint."""

import contextlib
import subprocess
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from tandem.cli.common import fail, find_policy

app = typer.Typer(
    help="Look at a policy file, evaluate it anywhere, convert LeRobot's ACT.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

FileArgument = Annotated[Path, typer.Argument(metavar="FILE", help="Policy file, or the folder of a run.")]


@app.command()
def info(
    file: FileArgument,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """What a policy file holds, how far its golden examples are off, and how long one evaluation takes."""
    _program("info", find_policy(file), *["--json"] * json)


@app.command()
def run(
    file: FileArgument,
    input: Annotated[
        Path,
        typer.Option(
            help="NPZ: observation (N, O) in the units of its names; noise (N, noise_size), else of seeds 0, 1, ...; "
            "image.CAMERA (N, H, W, 3) uint8."
        ),
    ],
    output: Annotated[Path, typer.Option(help="NPZ to write: chunk (N, h, A).")],
) -> None:
    """Evaluate a policy for N observations, by the very code that drives the arm."""
    import numpy as np

    from tandem.policy_file import encode_safetensors, read_safetensors

    policy = find_policy(file)
    with _sentences(), tempfile.TemporaryDirectory(prefix="tandem-policy-") as folder:
        inputs, outputs = Path(folder) / "in.safetensors", Path(folder) / "out.safetensors"
        try:
            with np.load(input) as arrays:
                tensors = {
                    name: arrays[name] if name.startswith("image.") else arrays[name].astype(np.float32)
                    for name in arrays.files
                }
            data = encode_safetensors(tensors, {})
        except (OSError, ValueError, KeyError, TypeError, AttributeError, zipfile.BadZipFile) as error:
            fail(f"{input} is not an NPZ file of numbers, images in uint8 ({error}).", 2)
        inputs.write_bytes(data)
        _program("run", policy, "--input", inputs, "--output", outputs)
        chunks, _ = read_safetensors(outputs)
        try:
            with output.open("wb") as destination:
                np.savez(destination, **chunks)  # type: ignore[arg-type]
        except OSError as error:
            fail(f"{output} can't be written ({error.strerror}).")


@app.command()
def convert(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER", help="LeRobot's checkpoint of an ACT policy: the folder pretrained_model."
        ),
    ],
    destination: Annotated[Path, typer.Argument(metavar="DEST", help="Policy file to write (.safetensors).")],
    bfloat16: Annotated[
        bool, typer.Option("--bfloat16", help="Store matrices in 16 bits: faster, about 0.4 % off.")
    ] = False,
) -> None:
    """Make a policy file from LeRobot's ACT. What can't be followed exactly is refused and named."""
    from tandem.learner.xla import configure

    configure()
    from tandem.lerobot_act import convert as convert_act

    with _sentences():
        written = convert_act(source, destination, bfloat16)
    print(f"{written.path}: {written.n_bytes / 1e6:.1f} MB")


@contextlib.contextmanager
def _sentences() -> Iterator[None]:
    from tandem.policy_file import PolicyFileError

    try:
        yield
    except PolicyFileError as error:
        fail(str(error), 2)
    except OSError as error:
        fail(f"{error.filename} can't be written ({error.strerror}).")


def _program(*arguments: str | Path) -> None:
    """tandem_policy, whose sentences and exit code are ours."""
    from tandem import processes, run_folder

    program: processes.Command = [run_folder.program("tandem_policy"), *arguments]
    if sentence := processes.missing_program(program):
        fail(sentence)
    code = subprocess.run([str(word) for word in program]).returncode
    if code != 0:
        raise typer.Exit(code)
