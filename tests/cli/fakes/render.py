"""Stand-in for tandem_render."""

import sys
from pathlib import Path

assert Path(sys.argv[1]).exists()
Path(sys.argv[2]).write_bytes(b"video")
