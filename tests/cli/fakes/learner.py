"""Stand-in for tandem.learner: a checkpoint at each multiple of evaluation_every; ends by itself."""

import argparse
import json
import os
import signal
import struct
import sys
from pathlib import Path

import lcm
import yaml
from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.learner_status_t import learner_status_t

parser = argparse.ArgumentParser()
for option in ("--scenario", "--run", "--lcm-url"):
    parser.add_argument(option)
arguments = parser.parse_args()
every = yaml.safe_load(Path(arguments.scenario).read_text())["run"]["evaluation_every"]
checkpoints = Path(arguments.run) / "checkpoints"
checkpoints.mkdir(exist_ok=True)
finished = False
report = learner_status_t()


def save(steps: int) -> None:
    head = {
        "format": "tandem-policy-1",
        "env_steps": str(steps),
        "updates": str(10 * steps),
        "task": "peg",
        "method": "tandem",
    }
    text = json.dumps({"__metadata__": head}).encode()
    (checkpoints / f"policy_at_{steps:07d}.safetensors").write_bytes(struct.pack("<Q", len(text)) + text)


def on_status(_channel: str, data: bytes) -> None:
    global finished
    status = controller_status_t.decode(data)
    finished = status.state == status.FINISHED
    if (status.env_steps_total and status.env_steps_total % every == 0) or finished:
        save(status.env_steps_total)
    report.updates_done = 10 * status.env_steps_total
    report.episodes_trained_through = status.episode
    report.wall_updates_per_s = 250.0
    report.win_share = 0.4
    link.publish("LEARNER_STATUS", report.encode())
    if os.environ.get("FAKE_LEARNER") == "die" and status.env_steps_total > 20:
        print("method.learner.batch is too much\nout of memory", flush=True)
        os.kill(os.getpid(), signal.SIGKILL)


def stop(*_: object) -> None:
    print("learner saved", flush=True)
    sys.exit(0)


signal.signal(signal.SIGTERM, stop)
link = lcm.LCM(arguments.lcm_url)
link.subscribe("CONTROLLER_STATUS", on_status)
while not finished:
    link.handle_timeout(100)
