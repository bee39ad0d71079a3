"""A device that vanishes while it has the arm: hold, then hand back."""

from typing import Any, ClassVar

import pytest
from tandem_lcm.tandem.controller_command_t import controller_command_t
from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.teleop_command_t import teleop_command_t
from tandem_lcm.tandem.world_state_t import world_state_t

from tandem.teleop.device import Action
from tandem.teleop.keys import Key
from tandem.teleop.session import HOLD_S, ORDER_S, SEND_S, Session


class Device:
    operator_id = "gamepad"
    help: ClassVar = [("a", "b")]
    gone = False

    def key(self, key: Key, now: float) -> Action | None:
        return None

    def poll(self, now: float) -> list[Action]:
        return []

    def twist(self, now: float, dt: float) -> list[float]:
        return [1.0] * 6

    def lost(self) -> str:
        return "the pad is gone" if self.gone else ""

    def describe(self, now: float) -> str:
        return ""


class Wire:
    """Keeps what is published."""

    def __init__(self) -> None:
        self.sent: list[Any] = []

    def subscribe(self, *_: object) -> None: ...

    def publish(self, message: Any) -> None:
        self.sent.append(message)


class Bench:
    def __init__(self, phase: int = world_state_t.TRAINING) -> None:
        self.device, self.wire, self.now = Device(), Wire(), 100.0
        self.session = Session(self.wire, self.device, "title")  # type: ignore[arg-type]
        self.status = controller_status_t()
        self.status.state, self.status.phase = controller_status_t.RUNNING, phase
        self.tell()

    def tell(self) -> None:
        self.session.watch._hear_status(self.status, b"")

    def run(self, seconds: float) -> list[Any]:
        start = len(self.wire.sent)
        for _ in range(round(seconds / SEND_S)):
            self.now += SEND_S
            self.tell()
            self.session._send(self.now, SEND_S)
        return [m for m in self.wire.sent[start:] if isinstance(m, teleop_command_t)]


def test_a_lost_pad_holds_then_hands_back_and_does_not_take_the_arm_again() -> None:
    bench = Bench()
    bench.session.do(Action.engage, bench.now)
    assert all(c.engaged and c.device_twist[0] > 0 for c in bench.run(0.2))
    bench.device.gone = True
    sent = bench.run(2 * HOLD_S)
    assert all(list(c.device_twist) == [0.0] * 6 for c in sent)
    held = [bool(c.engaged) for c in sent]
    assert held[0] and not held[-1] and held == sorted(held, reverse=True)
    assert sum(held) * SEND_S == pytest.approx(HOLD_S, abs=3 * SEND_S)
    bench.device.gone = False
    assert not any(c.engaged for c in bench.run(0.2))


def test_an_episodes_end_takes_the_hands_off_in_training_only() -> None:
    for phase, stays in ((world_state_t.TRAINING, False), (world_state_t.DEMONSTRATION, True)):
        bench = Bench(phase)
        bench.session.do(Action.engage, bench.now)
        bench.status.episode += 1
        assert bool(bench.run(0.1)[-1].engaged) is stays


def test_a_fault_takes_the_hands_off() -> None:
    bench = Bench(world_state_t.DEMONSTRATION)
    bench.session.do(Action.engage, bench.now)
    bench.status.state = controller_status_t.HALTED
    assert not bench.run(0.1)[-1].engaged
    bench.session.do(Action.engage, bench.now)
    assert not bench.run(0.1)[-1].engaged


def test_an_order_is_repeated_until_it_is_confirmed_and_then_given_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = Bench()
    monkeypatch.setattr("time.monotonic", lambda: bench.now)
    bench.session.do(Action.estop, bench.now)
    bench.run(ORDER_S + 0.5)
    orders = [m for m in bench.wire.sent if isinstance(m, controller_command_t)]
    assert len(orders) > 10 and {m.order for m in orders} == {controller_command_t.ESTOP}
    assert "NOT CONFIRMED" in bench.session.note
    bench.wire.sent.clear()
    bench.run(0.5)
    assert not any(isinstance(m, controller_command_t) for m in bench.wire.sent)


def test_labels_are_refused_when_nothing_runs() -> None:
    bench = Bench()
    bench.status.state = controller_status_t.WAITING
    bench.tell()
    bench.session.do(Action.success, bench.now)
    assert not any(c.label for c in bench.run(0.1))
    assert "nothing to label" in bench.session.note
