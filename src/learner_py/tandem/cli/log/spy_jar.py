"""`tandem log spy-jar`."""

from pathlib import Path
from typing import Annotated

import typer

from tandem.cli.common import sentences


def spy_jar(
    out: Annotated[Path, typer.Argument(help="Jar to write.")] = Path("tandem_types.jar"),
) -> None:
    """Build the jar of message types for LCM's own viewer, lcm-spy. Needs a JDK."""
    from tandem.log.spy_jar import build, lcm_program

    with sentences():
        build(out)
    print(f"{out}: start the viewer by  CLASSPATH={out} {lcm_program('lcm-spy')} --lcm-url=URL")
