"""`tandem bench export LOG`: how fast each format is written."""

import os
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from tandem.cli.common import JsonOption, sentences, write_json
from tandem.cli.export import SUFFIX, Format, measure


def export(
    log: Annotated[Path, typer.Argument(help="Event log, or a run folder.")],
    json_file: JsonOption = None,
) -> None:
    """Every format of `./tandem export` from one log, into a temporary folder; MB of the log per second.

    JSON: rows of {format, counts, log_bytes, out_bytes, seconds, cpu_s, log_mb_per_s}, load_average.
    """
    from rich.console import Console
    from rich.table import Table

    from tandem.cli.log import find
    from tandem.export.source import open_source

    with sentences(), tempfile.TemporaryDirectory(prefix="tandem-bench-") as folder:
        source = open_source(find(log))
        rows = [measure(kind, source, Path(folder) / f"log{SUFFIX[kind]}") for kind in Format]
    shown = Table(title=f"{log}: {1e-6 * rows[0]['log_bytes']:.1f} MB")
    for column in ("format", "written MB", "seconds", "CPU s", "MB of log / s"):
        shown.add_column(column, justify="left" if column == "format" else "right")
    for row in rows:
        figures = (1e-6 * row["out_bytes"], row["seconds"], row["cpu_s"], row["log_mb_per_s"])
        shown.add_row(row["format"], *(f"{figure:.1f}" for figure in figures))
    Console().print(shown)
    write_json(json_file, {"rows": rows, "load_average": os.getloadavg()[0]})
