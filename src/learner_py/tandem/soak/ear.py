"""What was said on the LCM network during a soak, kept by a thread of its own."""

from __future__ import annotations

import threading
import time
from collections import Counter
from typing import Any

from tandem_lcm.tandem.controller_fault_t import controller_fault_t
from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.episode_ack_t import episode_ack_t
from tandem_lcm.tandem.learner_status_t import learner_status_t
from tandem_lcm.tandem.policy_ack_t import policy_ack_t
from tandem_lcm.tandem.teleop_command_t import teleop_command_t

from tandem.wire import Wire

OPERATOR = "scripted"  # operator.name of the scenario
SOURCES = ("policy", "operator", "link")
GRADES = ("fresh", "hold", "damp", "stop")


class Ear:
    """Members may be read from any thread; each is replaced whole or only grows."""

    def __init__(self, lcm_url: str) -> None:
        self.status: Any = None  # controller_status_t, latest
        self.status_at = 0.0  # s, monotonic
        self.learner: Any = None  # learner_status_t, latest
        self.learner_at = 0.0
        self.engaged = False  # the operator wants authority
        self.acknowledged: Counter[int] = Counter()  # episode -> EPISODE_ACKs heard, whoever sent them
        self.halted_by: Counter[int] = Counter()  # fault -> times that the arm stood halted by it
        self.faults: Counter[int] = Counter()  # fault -> CONTROLLER_FAULTs
        self.refusals: Counter[str] = Counter()  # reason of a refused policy, without its file
        self.policies_taken = 0  # POLICY_ACKs that accept, repeats included
        self.grades: Counter[str] = Counter()  # "policy hold" -> CONTROLLER_STATUS that said so
        self._wire = Wire(lcm_url)
        self._ended = threading.Event()
        self._wire.subscribe(controller_status_t, self._on_status)
        self._wire.subscribe(learner_status_t, self._on_learner)
        self._wire.subscribe(episode_ack_t, self._on_episode_ack)
        self._wire.subscribe(controller_fault_t, self._on_fault)
        self._wire.subscribe(policy_ack_t, self._on_policy_ack)
        self._wire.subscribe(teleop_command_t, self._on_teleop)
        self._thread = threading.Thread(target=self._listen, name="ear", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._ended.set()
        self._thread.join()

    def halted(self) -> bool:
        return self.status is not None and self.status.state == controller_status_t.HALTED

    def _listen(self) -> None:
        while not self._ended.is_set():
            self._wire.handle(timeout_s=0.05)

    def _on_status(self, status: controller_status_t, _data: bytes) -> None:
        was_halted = self.halted() and self.status.fault == status.fault
        self.status, self.status_at = status, time.monotonic()
        if self.halted() and not was_halted:
            self.halted_by[status.fault] += 1
        for source, grade in zip(SOURCES, status.source_grade, strict=True):
            if 0 < grade < len(GRADES):
                self.grades[f"{source} {GRADES[grade]}"] += 1

    def _on_learner(self, status: learner_status_t, _data: bytes) -> None:
        if status.method:  # not one of the monkey's
            self.learner, self.learner_at = status, time.monotonic()

    def _on_episode_ack(self, ack: episode_ack_t, _data: bytes) -> None:
        self.acknowledged[ack.episode_acknowledged] += 1

    def _on_fault(self, fault: controller_fault_t, _data: bytes) -> None:
        self.faults[fault.fault] += 1

    def _on_policy_ack(self, ack: policy_ack_t, _data: bytes) -> None:
        if ack.accepted:
            self.policies_taken += 1
        else:
            self.refusals[ack.reason.rsplit(".safetensors: ", 1)[-1]] += 1

    def _on_teleop(self, command: teleop_command_t, _data: bytes) -> None:
        if command.operator_id == OPERATOR:
            self.engaged = command.engaged == 1
