"""Learner and operator of `tandem bench handover`: policies that were written before, and hands that come and go.

Everything is sent at its time by one thread: TELEOP_COMMAND 100 times a second and whenever somebody engages or lets
go, a new policy every 105 ms in busy phases, LEARNER_STATUS and acknowledgements as a learner does.
"""

from __future__ import annotations

import itertools
import math
import random
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tandem_lcm.tandem.action_chunk_t import action_chunk_t
from tandem_lcm.tandem.controller_command_t import controller_command_t
from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.episode_ack_t import episode_ack_t
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.learner_status_t import learner_status_t
from tandem_lcm.tandem.policy_ack_t import policy_ack_t
from tandem_lcm.tandem.policy_announce_t import policy_announce_t
from tandem_lcm.tandem.robot_state_t import robot_state_t
from tandem_lcm.tandem.teleop_command_t import teleop_command_t

from tandem import policy_file, run_folder
from tandem.cli.handover_count import AUTHORITY, Phase
from tandem.processes import Child
from tandem.wire import Wire, utime

ANNOUNCE_S = 0.105  # a little more than a policy step, in which one policy at most comes into force
TELEOP_S = 0.010
HEARTBEAT_S = 0.5  # LEARNER_STATUS
ENGAGED_S = (0.050, 0.100)  # of random length; alpha is at 0.9 after 45 ms
RELEASED_S = (0.095, 0.145)  # alpha is back at 0 after 100 ms, so that some engage on the way
HANDOVER_S = 0.25  # of a busy phase for each one that is complete, about
PHASE_S = 5.0
BETWEEN_S = 0.5  # belongs to no phase: what a busy one left is over before a quiet one begins
START_S = 30.0
HEAR_S = 0.002  # longest wait for messages, so that nothing is sent late


@dataclass
class Wanted:
    """How many of each the run should have."""

    swaps: int
    handovers: int

    @property
    def busy_s(self) -> float:
        """About so much time in busy phases gives both."""
        return max(self.swaps * ANNOUNCE_S, self.handovers * HANDOVER_S)

    @property
    def longest_busy_s(self) -> float:
        """When even this does not give both, the run ends with what it has."""
        return 1.3 * self.busy_s + 2.0 * PHASE_S

    @property
    def policies(self) -> int:
        return math.ceil((self.longest_busy_s + PHASE_S) / ANNOUNCE_S) + 1


def write_policies(folder: Path, scenario: dict[str, Any], n: int) -> list[policy_announce_t]:
    """Valid policy files of versions 1 to n, and what announces each. The method's own network with random numbers;
    each policy pushes elsewhere, so that a swap is felt."""
    task, method = scenario["task"], scenario["method"]
    head, horizon = method["learner"]["head"], method["horizon"]
    rng = np.random.default_rng(0)
    n_in, n_axes = len(task["observation"]), len(task["action_axes"])
    widths = [n_in, *head["hidden"]]
    layers = []
    for into, out in itertools.pairwise(widths):
        layer = {"weight": rng.normal(0.0, math.sqrt(2.0 / into), (out, into)), "bias": np.zeros(out)}
        if head["layer_norm"]:
            layer |= {"norm_scale": np.ones(out), "norm_offset": np.zeros(out)}
        layers.append(layer)
    # Only the last bias reaches the output; the network is computed all the same, and what it gives is known.
    last = np.zeros((horizon * n_axes, widths[-1]))
    golden = rng.normal(size=(8, n_in))
    facts: dict[str, Any] = {
        "config": {
            **{key: head[key] for key in ("hidden", "activation", "layer_norm")},
            "horizon": horizon,
            "output": "tanh",
        },
        "observation": task["observation"],
        "action": task["action_axes"],
        "task": task["name"],
        "method": method["name"],
        "execution": method["execution"],
        "discount": method["discount"],
        "env_steps": 0,
        "episodes_trained_through": -1,
        "git_revision": run_folder.git_revision(),
    }
    announcements = []
    for version in range(1, n + 1):
        bias = np.tile(rng.uniform(-0.5, 0.5, n_axes), horizon)
        chunk = np.tile(np.tanh(bias), (len(golden), 1)).reshape(len(golden), horizon, n_axes)
        written = policy_file.write_policy(
            folder / f"policy_{version:05d}.safetensors",
            policy_file.PolicyHeader(version=version, updates=version, **facts),
            {"layers": [*layers, {"weight": last, "bias": bias}]},
            np.zeros(n_in),
            np.ones(n_in),
            {"observation": golden, "chunk": chunk},
        )
        message = policy_announce_t()
        message.version, message.updates, message.episodes_trained_through = version, version, -1
        message.path, message.n_bytes, message.sha256 = str(written.path), written.n_bytes, written.sha256
        announcements.append(message)
    return announcements


class Partner:
    """One run's learner and operator.

    What it counts itself comes over UDP, alpha 100 times a second, and only decides when to end: the log has the truth.
    """

    def __init__(
        self, url: str, policies: list[policy_announce_t], controller: Child, wanted: Wanted
    ) -> None:
        self.failure: str | None = None  # a sentence when the run can't go on
        self._policies: Iterator[policy_announce_t] = iter(policies)
        self._controller = controller
        self._wanted = wanted
        self._swaps = self._handovers = 0
        self._status: Any = None
        self._version = 0
        self._had_authority = False
        self._random = random.Random(0)
        self._teleop: Any = teleop_command_t()
        self._teleop.episode_answered = self._teleop.tick_answered = -1
        self._teleop.operator_id = "bench"
        self._wire = Wire(url)
        self._wire.subscribe(controller_status_t, self._on_status)
        self._wire.subscribe(policy_ack_t, self._on_policy)
        self._wire.subscribe(action_chunk_t, self._on_chunk)
        self._wire.subscribe(robot_state_t, self._on_state)
        self._wire.subscribe(episode_end_t, self._on_episode)

    def run(self) -> list[Phase]:
        """Until the controller may be ended, or `failure`. Returns the phases, as many busy ones as quiet ones."""
        self._begin()
        phases: list[Phase] = []
        busy_s = 0.0
        while not self.failure and not self._enough() and busy_s < self._wanted.longest_busy_s:
            for busy in (True, False):
                self._for(BETWEEN_S, busy=False)
                start = utime()
                self._for(PHASE_S, busy)
                phases.append(Phase(busy, start, utime()))
            busy_s += PHASE_S
        self._for(BETWEEN_S, busy=False)
        return phases

    def _begin(self) -> None:
        first = next(self._policies)
        deadline = time.monotonic() + START_S
        while not self.failure and not (self._status and self._status.state == controller_status_t.RUNNING):
            self._send(first)
            self._for(0.5, busy=False)
            if time.monotonic() > deadline:
                self.failure = f"The controller has not begun to move within {START_S:.0f} s."

    def _enough(self) -> bool:
        return self._swaps >= self._wanted.swaps and self._handovers >= self._wanted.handovers

    def _for(self, seconds: float, busy: bool) -> None:
        """Learner and operator for some time. Not busy: he is there, and lets the policy drive."""
        now = time.monotonic()
        end = now + seconds
        teleop = heartbeat = announce = now
        turn = now + self._random.uniform(*RELEASED_S)
        self._turn(engage=False)
        while now < end and not self.failure:
            if busy and now >= turn:
                self._turn(engage=not self._teleop.engaged)
                turn = now + self._random.uniform(*(ENGAGED_S if self._teleop.engaged else RELEASED_S))
                teleop = now
            if now >= teleop:
                teleop = now + TELEOP_S
                self._send(self._teleop)
            if busy and now >= announce:
                announce = now + ANNOUNCE_S
                if policy := next(self._policies, None):
                    self._send(policy)
            if now >= heartbeat:
                heartbeat = now + HEARTBEAT_S
                self._send(learner_status_t())
                if self._controller.poll() is not None:
                    self.failure = self._controller.death()
            self._wire.handle(HEAR_S)
            now = time.monotonic()
        self._turn(engage=False)
        self._send(self._teleop)

    def _turn(self, engage: bool) -> None:
        self._teleop.engaged = int(engage)
        self._teleop.device_twist = [self._random.uniform(-1.0, 1.0) if engage else 0.0 for _ in range(6)]

    def _send(self, message: Any) -> None:
        message.utime = utime()
        self._wire.publish(message)

    # ---- what the controller tells

    def _on_status(self, status: controller_status_t, _data: bytes) -> None:
        before, self._status = self._status, status
        # Somebody stands beside it and orders recovery, once a fault.
        if status.state == controller_status_t.HALTED and (not before or before.state != status.state):
            order: Any = controller_command_t()
            order.order, order.reason = controller_command_t.RECOVER, "bench"
            self._send(order)

    def _on_policy(self, answer: policy_ack_t, _data: bytes) -> None:
        if not answer.accepted:
            self.failure = f"The controller has refused a policy: {answer.reason}"

    def _on_chunk(self, chunk: action_chunk_t, _data: bytes) -> None:
        self._swaps += int(self._version not in (0, chunk.policy_version))
        self._version = chunk.policy_version

    def _on_state(self, state: robot_state_t, _data: bytes) -> None:
        if state.alpha >= AUTHORITY:
            self._had_authority = True
        elif state.alpha == 0.0 and self._had_authority:
            self._had_authority = False
            self._handovers += 1

    def _on_episode(self, end: episode_end_t, _data: bytes) -> None:
        answer: Any = episode_ack_t()
        answer.episode_acknowledged = end.episode
        self._send(answer)
