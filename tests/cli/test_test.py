"""`tandem test`: its own options and the reports of the sanitizers."""

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tandem.cli import test as command
from tandem.cli.app import app
from tandem.cli.test import FUZZED, Sanitizer, options
from tandem.run_folder import ROOT


def test_every_fuzz_target_is_called(tmp_path: Path) -> None:
    source = (ROOT / "tests" / "fuzz" / "targets.cpp").read_text()
    table = source[source.index("all = {") :]
    table = table[: table.index("};")]
    assert re.findall(r'\{"(\w+)"', table) == list(FUZZED)


def test_an_unknown_fuzz_target_is_refused_with_the_names_there_are() -> None:
    result = CliRunner().invoke(app, ["test", "--fuzz", "1", "NO_SUCH_CHANNEL"])
    assert result.exit_code == 2
    assert "TELEOP_COMMAND" in result.output


def test_a_report_of_a_program_that_nobody_asked_for_its_exit_code_fails_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "report.12").write_text("WARNING: ThreadSanitizer: data race")
    (tmp_path / "report.13").touch()
    assert command._tell(tmp_path) == 1
    assert "data race" in capsys.readouterr().err
    (tmp_path / "report.12").unlink()
    assert command._tell(tmp_path) == 0


@pytest.mark.parametrize("sanitizer", list(Sanitizer))
def test_suppression_files_exist_and_give_a_reason_for_each_line(
    sanitizer: Sanitizer, tmp_path: Path
) -> None:
    values = ":".join(options(sanitizer, tmp_path).values())
    (file,) = [Path(v.split("=", 1)[1]) for v in values.split(":") if v.startswith("suppressions=")]
    lines = file.read_text().splitlines()
    for before, line in zip(["", *lines], lines, strict=False):
        if line and not line.startswith("#"):
            assert before.startswith("#"), f"{file.name}: '{line}' has no reason above it"
