"""Stand-in for `tandem train`: train.py RUN SECONDS. Works as often as it is started, for SECONDS, then finishes.

RUN/starts has a line (monotonic time) a start, RUN/ends one a good end; RUN/cores: the cores that it may use.
FAIL in the folder's name: it fails.
"""

import json
import os
import signal
import sys
import time
from pathlib import Path

folder, seconds = Path(sys.argv[1]), float(sys.argv[2])


def stop(number: int, _frame: object) -> None:
    (folder / "stopped_by").write_text(signal.Signals(number).name)
    print("stopped in order", flush=True)
    sys.exit(130)


signal.signal(signal.SIGINT, stop)
signal.signal(signal.SIGTERM, stop)
folder.mkdir(parents=True, exist_ok=True)
(folder / "scenario.yaml").touch()
(folder / "cores").write_text(" ".join(map(str, sorted(os.sched_getaffinity(0)))))
with (folder / "starts").open("a") as file:
    file.write(f"{time.monotonic()}\n")
print("begun", flush=True)
time.sleep(seconds)
if "FAIL" in folder.name:
    print("tandem: the arm has no power.\nAll of its output: elsewhere", flush=True)
    sys.exit(3)
with (folder / "ends").open("a") as file:
    file.write(f"{time.monotonic()}\n")
fresh = {"successes": 9, "episodes": 10}
(folder / "summary.json").write_text(json.dumps({"fresh": {"selected": fresh}}))
