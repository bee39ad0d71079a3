"""The command line: one file a command. Heavy imports wait until their command runs: --help comes at once."""

from tandem.cli.app import main

__all__ = ["main"]
