"""What `tandem bench log` reads is the log, by every reader, and its figures come out under their names."""

import json
from pathlib import Path

import lcm
from tandem_lcm.tandem.robot_state_t import robot_state_t
from typer.testing import CliRunner

from tandem import log_bench
from tandem.cli.app import app
from tandem.log.index import scan_log


def log(path: Path) -> Path:
    file = lcm.EventLog(str(path), "w", overwrite=True)
    for n in range(500):
        file.write_event(n, "ROBOT_STATE", robot_state_t().encode())
    file.close()
    return path


def test_log_is_repeated_whole(tmp_path: Path) -> None:
    source = log(tmp_path / "log.lcm")
    copies = log_bench.repeat(source, tmp_path / "large.lcm", 1.0)
    assert copies == round(1e6 / source.stat().st_size)
    index = scan_log(tmp_path / "large.lcm")
    assert len(index) == 500 * copies and index.damage == [] and index.cut_off_bytes == 0


def test_figures_of_every_reader_are_written(tmp_path: Path) -> None:
    source, figures = log(tmp_path / "log.lcm"), tmp_path / "bench.json"
    command = ["bench", "log", "--log", str(source), "--mb", "1", "--rounds", "1", "--folder", str(tmp_path)]
    result = CliRunner().invoke(app, [*command, "--json", str(figures)])
    assert result.exit_code == 0, result.output
    value = json.loads(figures.read_text())
    kinds = [row["reader"].split(":")[0] for row in value["rows"]]
    assert kinds == ["index", "read", "read", "read", "decode", "decode", "start"]
    assert all(row["mb"] > 0.5 and row["mb_per_s"] > 0 and row["mb_per_cpu_s"] > 0 for row in value["rows"])
    assert value["events"] == 500 * value["copies"]
