"""Stand-in for tandem_controller: episodes of ten steps that all succeed, as fast as they can be told."""

import argparse
import json
import os
import signal
import struct
import sys
import time
from pathlib import Path

import lcm
import yaml
from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.world_state_t import world_state_t

STEPS = 10
parser = argparse.ArgumentParser()
for option in ("--scenario", "--run", "--lcm-url", "--results"):
    parser.add_argument(option, type=str)
parser.add_argument("--check", action="store_true")
arguments = parser.parse_args()
scenario = yaml.safe_load(Path(arguments.scenario).read_text())
run = scenario["run"]

if scenario["task"]["policy_rate_hz"] == 0:
    lines = Path(arguments.scenario).read_text().splitlines()
    number = next(i for i, line in enumerate(lines, 1) if "policy_rate_hz" in line)
    print(
        f"{arguments.scenario}:{number}: task.policy_rate_hz is 0; it must be in [1, 200].", file=sys.stderr
    )
    sys.exit(2)
if arguments.check:
    sys.exit(0)


def results(n: int) -> None:
    episodes = [
        {
            "episode": i, "seed": i, "outcome": "success" if i % 5 else "timeout", "n_steps": STEPS,
            "n_takeovers": 0, "n_intervention_steps": 0, "force_peak": 5.0, "force_filtered_peak": 4.0,
        }
        for i in range(n)
    ]  # fmt: skip
    Path(arguments.results).write_text(
        json.dumps({"episodes": episodes, "env_steps_per_s": 400.0, "ticks": 1, "overruns": 0})
    )


if run["mode"] in ("evaluate", "demonstrate"):
    assert run["seed"] >= 1_000_000
    (Path(arguments.run) / "log.lcm").touch()
    results(run["episodes"])
    sys.exit(0)

log_file = Path(arguments.run) / "log.lcm"
first = steps = 0
if log_file.exists():
    for event in lcm.EventLog(str(log_file), "r"):
        end = episode_end_t.decode(event.data)
        first, steps = end.episode + 1, end.env_steps_total

stopped = False


def stop(_signal: int, _frame: object) -> None:
    global stopped
    stopped = True


signal.signal(signal.SIGTERM, stop)
link = lcm.LCM(arguments.lcm_url)
status = controller_status_t()
status.env_steps_budget = run["env_steps"]
status.lockstep = 1
status.state = status.RUNNING
status.episodes_without_motion = int(os.environ.get("FAKE_WITHOUT_MOTION", "0"))


def tell() -> None:
    status.env_steps_total = steps
    link.publish("CONTROLLER_STATUS", status.encode())


tell()
log = log_file.open("ab")  # lcm.EventLog can't append
episode = first
while steps < run["env_steps"] and not stopped:
    time.sleep(float(os.environ.get("FAKE_EPISODE_S", "0.05")))
    end = episode_end_t()
    end.episode = episode
    end.phase = world_state_t.DEMONSTRATION if episode < run["demonstrations"] else world_state_t.TRAINING
    end.n_steps = STEPS
    end.n_intervention_steps = 3
    end.n_takeovers = 1
    if end.phase == world_state_t.TRAINING:
        steps += STEPS
    end.env_steps_total = steps
    status.phase, status.episode = end.phase, episode
    channel, data = b"EPISODE_END", end.encode()
    log.write(struct.pack(">IQQII", 0xEDA1DA01, episode, 0, len(channel), len(data)) + channel + data)
    log.flush()
    link.publish("EPISODE_END", end.encode())
    link.publish("EPISODE_END", end.encode())  # sent again, as the real one does
    tell()
    if os.environ.get("FAKE_CONTROLLER") == "fault" and episode == 3:
        print("joint 4 left its range")
        sys.exit(3)
    episode += 1
log.close()
print("controller stopped in order" if stopped else "controller finished", flush=True)
if not stopped:
    status.state = status.FINISHED
    for _ in range(5):
        tell()
        time.sleep(0.02)
    results(episode)
sys.exit(130 if stopped else 0)
