"""What goes wrong when. Times and choices come from the seed alone; what they hit depends on the machine."""

from __future__ import annotations

import random
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import lcm
from tandem_lcm.tandem.controller_command_t import controller_command_t
from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.episode_ack_t import episode_ack_t
from tandem_lcm.tandem.episode_request_t import episode_request_t

from tandem import gains
from tandem.faults import ESTOP
from tandem.run_folder import RunFolder
from tandem.scenario import Scenario
from tandem.soak import bad_policies
from tandem.soak.ear import Ear
from tandem.soak.garbage import garbage
from tandem.soak.programs import Programs
from tandem.wire import CHANNEL_OF, utime

USER_STOP = 9  # Fault in src/controller/robot/fault.h
RECOVER_AFTER_S = 1.0  # a person looks first
PRESS_AGAIN_S = 0.7
MID_INTERVENTION_S = 15.0  # so long it waits for an intervention to break into
HALT_S = 40.0  # and so long for another fault, to press the e-stop on top of it
HALTED_WITHIN_S = 10.0  # of an e-stop


@dataclass
class _Deed:
    name: str
    every_s: float  # mean; gaps are exponential
    do: Callable[[random.Random], bool]  # False: not possible now, try again soon
    rng: random.Random
    due: float  # s, monotonic


class Monkey:
    """Call `step` often, from the main thread. `done` counts deeds by name."""

    def __init__(
        self, seed: int, folder: RunFolder, scenario: Scenario, programs: Programs, ear: Ear, lcm_url: str
    ) -> None:
        self.done: Counter[str] = Counter()
        self.forged_acknowledgements: set[int] = set()
        self.ignored_estops = 0  # no HALTED by it followed
        self._folder, self._programs, self._ear = folder, programs, ear
        self._lcm = lcm.LCM(lcm_url)
        self._law = scenario.data["controller"]["law"]
        self._away: dict[str, tuple[float, Callable[[str], None]]] = {}  # who: when (s), what brings it back
        self._n_policies = 0
        self._halted_since: float | None = None  # by a stop that only a person undoes
        self._pressed = 0.0
        self._wait_engaged_until = 0.0
        self._wait_halted_until = 0.0
        self._estop_by: float | None = None  # an e-stop was given; the arm is to be halted by it until then
        now = time.monotonic()
        table: tuple[tuple[str, float, Callable[[random.Random], bool]], ...] = (
            ("garbage", 0.5, self._send_garbage),
            ("bad policy", 12.0, self._announce_bad_policy),
            ("gains", 20.0, self._change_gains),
            ("operator paused", 20.0, self._pause_operator),
            ("operator killed", 80.0, self._kill_operator),
            ("learner killed", 70.0, self._kill_learner),
            ("e-stop", 60.0, self._estop),
            ("discard", 50.0, self._discard),
            ("false acknowledgement", 40.0, self._acknowledge_falsely),
            ("needless request", 20.0, self._request_needlessly),
        )
        self._deeds = []
        for name, every_s, do in table:
            rng = random.Random(f"{seed} {name}")
            self._deeds.append(_Deed(name, every_s, do, rng, now + rng.uniform(0.0, every_s)))

    def step(self, mischief: bool = True) -> None:
        """What is due now. Without mischief it only makes good: starts, continues and recovers."""
        now = time.monotonic()
        for name, (due, bring_back) in list(self._away.items()):
            if due <= now:
                del self._away[name]
                bring_back(name)
        self._watch_estop(now)
        self._recover(now)
        for deed in self._deeds if mischief else ():
            if deed.due > now:
                continue
            if deed.do(deed.rng):
                self.done[deed.name] += 1
                deed.due = now + deed.rng.expovariate(1.0 / deed.every_s)
            else:
                deed.due = now + 0.02

    @property
    def made_good(self) -> bool:
        """All programs are there, and no stop of ours holds the arm."""
        return not self._away and self._halted_since is None and self._estop_by is None

    # ---- programs

    def _send_away(self, name: str, seconds: float, bring_back: Callable[[str], None]) -> None:
        self._away[name] = (time.monotonic() + seconds, bring_back)

    def _pause_operator(self, rng: random.Random) -> bool:
        """Half of the time in the middle of an intervention, if one comes soon."""
        now = time.monotonic()
        if "operator" in self._away:
            return False
        if not self._wait_engaged_until:
            self._wait_engaged_until = now + (MID_INTERVENTION_S if rng.random() < 0.5 else 0.0)
        if not self._ear.engaged and now < self._wait_engaged_until:
            return False
        self._wait_engaged_until = 0.0
        self.done["operator paused while engaged"] += int(self._ear.engaged)
        self._programs.pause("operator")
        self._send_away("operator", 0.1 * 60.0 ** rng.random(), self._programs.go_on)
        return True

    def _kill_operator(self, rng: random.Random) -> bool:
        if "operator" in self._away:
            return False
        self._programs.kill("operator")
        self._send_away("operator", rng.uniform(0.2, 5.0), self._programs.start)
        return True

    def _kill_learner(self, rng: random.Random) -> bool:
        """Not before it has said that it works: else a quick monkey and a slow machine keep it from ever learning."""
        heard = self._ear.learner_at > self._programs.started_at["learner"] + 1.0
        if "learner" in self._away or not heard:
            return False
        self._programs.kill("learner")
        self._send_away("learner", rng.uniform(1.0, 5.0), self._programs.start)
        return True

    # ---- messages

    def _send(self, message: Any) -> None:
        self._lcm.publish(CHANNEL_OF[type(message)], message.encode())

    def _send_garbage(self, rng: random.Random) -> bool:
        for _ in range(rng.choice((1, 1, 1, 20))):
            one = garbage(rng)
            self._lcm.publish(one.channel, one.data)
            self.done[f"garbage on {one.channel}"] += 1
            self.done[f"garbage: {one.kind}"] += 1
        return True

    def _announce_bad_policy(self, rng: random.Random) -> bool:
        kind = rng.choice(bad_policies.REFUSED + bad_policies.TAKEN)
        good = max(
            (self._folder.path / "policies").glob("policy_*.safetensors"), default=None, key=lambda p: p.name
        )
        try:
            message = bad_policies.bad_policy(kind, rng, self._folder.path, good, self._n_policies)
        except FileNotFoundError:  # the learner has cleared it away meanwhile
            return False
        if message is None:
            return False
        self._n_policies += 1
        self._send(message)
        self.done[f"policy: {kind}"] += 1
        return True

    def _change_gains(self, rng: random.Random) -> bool:
        linear, angular = rng.uniform(800.0, 2500.0), rng.uniform(60.0, 200.0)
        clip = rng.uniform(0.005, 0.012)
        message = gains.message(
            self._law,
            stiffness=",".join([f"{linear}"] * 3 + [f"{angular}"] * 3),
            damping_ratio=rng.uniform(0.7, 1.3),
            error_clip=",".join([f"{clip}"] * 3 + [f"{10 * clip}"] * 3),
            axes=rng.choice(("base", "tool")),
        )
        message.utime = utime()
        self._send(message)
        return True

    def _order(self, order: int) -> None:
        message = controller_command_t()
        message.utime, message.order, message.reason = utime(), order, "soak"
        self._send(message)

    def _estop(self, rng: random.Random) -> bool:
        """At any time; often while another fault is latched, because the one must not undo the other."""
        now = time.monotonic()
        if self._estop_by is not None:
            return False
        if not self._wait_halted_until:
            self._wait_halted_until = now + (HALT_S if rng.random() < 0.4 else 0.0)
        if not self._ear.halted() and now < self._wait_halted_until:
            return False
        self._wait_halted_until = 0.0
        self.done["e-stop while halted"] += int(self._ear.halted())
        self._order(controller_command_t.ESTOP)
        self._estop_by = time.monotonic() + HALTED_WITHIN_S
        return True

    def _watch_estop(self, now: float) -> None:
        if self._estop_by is None or self._ear.status is None:
            return
        if self._ear.halted() and self._ear.status.fault == ESTOP:
            self._estop_by = None
        elif self._ear.status.state == controller_status_t.WAITING:
            self._estop_by = now + HALTED_WITHIN_S  # nothing moves; it takes effect when something would
        elif now > self._estop_by:
            self._estop_by = None
            self.ignored_estops += 1

    def _discard(self, rng: random.Random) -> bool:
        if self._ear.status is None or self._ear.status.state != controller_status_t.RUNNING:
            return False
        self._order(controller_command_t.DISCARD)
        return True

    def _acknowledge_falsely(self, rng: random.Random) -> bool:
        """In the learner's name, an episode that the controller still waits to be confirmed."""
        status = self._ear.status
        if status is None or status.episodes_unacknowledged == 0:
            return False
        message = episode_ack_t()
        message.utime, message.episode_acknowledged = utime(), status.episode - 1
        self.forged_acknowledgements.add(message.episode_acknowledged)
        self._send(message)
        return True

    def _request_needlessly(self, rng: random.Random) -> bool:
        """Steps of the latest episode that nobody misses, or many times the same one."""
        if self._ear.status is None:
            return False
        message = episode_request_t()
        message.utime, message.episode_requested = utime(), self._ear.status.episode - 1
        message.missing_steps = [rng.randrange(3)] * rng.choice((1, 100, 30_000))
        message.n_missing = len(message.missing_steps)
        self._send(message)
        return True

    def _recover(self, now: float) -> None:
        """Undoes the stops that the scripted operator leaves to a person."""
        if not self._ear.halted() or self._ear.status.fault not in (ESTOP, USER_STOP):
            self._halted_since = None
            return
        if self._halted_since is None:
            self._halted_since = now
        if now - self._halted_since >= RECOVER_AFTER_S and now - self._pressed >= PRESS_AGAIN_S:
            self._pressed = now
            self.done["recover"] += 1
            self._order(controller_command_t.RECOVER)
