"""The loop of a person at the controls: keys and sticks in, TELEOP_COMMAND out at 50 Hz, the screen at 10 Hz."""

import contextlib
import os
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

from rich.console import Console
from rich.live import Live
from tandem_lcm.tandem.controller_command_t import controller_command_t
from tandem_lcm.tandem.teleop_command_t import teleop_command_t

from tandem.orders import Order
from tandem.teleop import screen, terminal
from tandem.teleop.device import Action, Device
from tandem.teleop.pilot import VERDICTS, Pilot
from tandem.teleop.training import Training
from tandem.teleop.watch import Watch
from tandem.wire import Wire

SEND_S = 0.02
DRAW_S = 0.1
LINE_S = 5.0  # between lines when stdout is no terminal
HOLD_S = 0.75  # a lost device stands still for so long before it hands back
FAREWELL_MESSAGES = 5  # hands off, said so often before leaving
ORDER_S = 3.0  # an order that is not confirmed by then is given up
PRESS_S = 1.0  # a key that is heard again within this is still the same press, repeated by the terminal

_LABELS = {
    Action.success: teleop_command_t.LABEL_SUCCESS,
    Action.failure: teleop_command_t.LABEL_FAIL,
    Action.discard: teleop_command_t.LABEL_DISCARD,
}
_ONCE_A_PRESS = (*_LABELS, Action.leave)


class Session:
    """One person, one device, one controller."""

    def __init__(
        self,
        wire: Wire,
        device: Device,
        title: str,
        training: Callable[[Wire], Training] | None = None,
        on_leave: Callable[[], bool] = lambda: True,
    ) -> None:
        """`on_leave` is called when the person wants to leave; False: somebody else will end us in good order."""
        self.wire, self.device = wire, device
        self.pilot = Pilot(device.operator_id)
        self.training = training(wire) if training else None
        self.watch = Watch(wire, self._hear_status)
        self.note = ""
        self._title = title
        self._on_leave = on_leave
        self._leaving = self._silently = False
        self._episode: int | None = None
        self._orders: dict[int, Order] = {}
        self._heard: dict[Action, float] = {}
        self._lost_at: float | None = None

    # ---- the loop

    def run(self, fd_in: int | None, console: Console) -> None:
        """Until the person leaves, the terminal is lost, or a signal asks for it. fd_in None: no keys."""
        with self._ended_by_signals(), self._terminal_may_go(), contextlib.ExitStack() as stack:
            live: Live | None = None
            keys: terminal.Keys | None = None
            if fd_in is not None:
                stack.enter_context(terminal.raw(fd_in))
            if console.is_terminal:
                live = Live(console=console, screen=True, auto_refresh=False)
                stack.enter_context(live)
            if fd_in is not None:
                keys = stack.enter_context(terminal.Keys(fd_in, sys.stdout.fileno() if live else fd_in))
            self._loop(keys, live, console)
        if not self._silently:
            self.pilot.release()
            for _ in range(FAREWELL_MESSAGES):
                self.wire.publish(self.pilot.command([0.0] * 6))

    def _loop(self, keys: terminal.Keys | None, live: Live | None, console: Console) -> None:
        files: list[Any] = [self.wire, *([keys] if keys else [])]
        send_at = draw_at = sent_at = time.monotonic()
        while not self._leaving:
            ready, _, _ = select.select(files, [], [], max(0.0, send_at - time.monotonic()))
            now = time.monotonic()
            if keys in ready and keys is not None:
                self._listen(keys, now)
            self.wire.handle(0.0)
            if now >= send_at:
                self._send(now, min(now - sent_at, 2 * SEND_S))
                sent_at, send_at = now, max(send_at + SEND_S, now)
            if now >= draw_at:
                draw_at = now + (DRAW_S if live else LINE_S)
                self._draw(live, console, now)

    def _listen(self, keys: terminal.Keys, now: float) -> None:
        try:
            for key in keys.read(now):
                if action := self.device.key(key, now):
                    self.do(action, now)
        except terminal.TerminalLost:
            # Nobody is there to see what the arm does: silence makes the controller hold, then hand back.
            self._leaving = self._silently = True

    def _send(self, now: float, dt: float) -> None:
        for action in self.device.poll(now):
            self.do(action, now)
        twist = self.device.twist(now, dt)
        if self._is_lost(now):
            twist = [0.0] * 6
        self.wire.publish(self.pilot.command(twist))
        self._chase_orders(now)

    def _chase_orders(self, now: float) -> None:
        for order in list(self._orders.values()):
            if order.done(None if self.watch.silent else self.watch.status):
                self.note = f"{order.reason}: done"
            elif now - order.given > ORDER_S:
                self.note = f"{order.reason}: NOT CONFIRMED by the controller"
            else:
                if order.due(now):
                    self.wire.publish(order.message())
                continue
            del self._orders[order.order]

    def _is_lost(self, now: float) -> bool:
        """The device is gone: hold, then hand back."""
        if not self.device.lost():
            self._lost_at = None
            return False
        if self._lost_at is None:
            self._lost_at = now
            if self.pilot.engaged:
                self.note = "the arm holds still, then the policy has it"
        if now - self._lost_at > HOLD_S:
            self.pilot.release()
        return True

    # ---- what is asked for

    def do(self, action: Action, now: float) -> None:
        """One thing that the person wants."""
        again = now - self._heard.get(action, -PRESS_S) < PRESS_S
        self._heard[action] = now
        if again and action in _ONCE_A_PRESS:
            return
        self.note = action.value
        match action:
            case Action.engage:
                self._engage()
            case Action.release:
                self.pilot.release()
            case Action.success | Action.failure | Action.discard:
                self._label(_LABELS[action])
            case Action.open | Action.close:
                self.pilot.gripper = -1.0 if action is Action.open else 1.0
            case Action.faster | Action.slower:
                self.pilot.change_speed(1 if action is Action.faster else -1)
            case Action.estop:
                self.pilot.release()
                self._orders.pop(controller_command_t.RECOVER, None)
                self._order(controller_command_t.ESTOP, "e-stop", now)
            case Action.recover:
                if self.watch.halted:
                    self._orders.pop(controller_command_t.ESTOP, None)
                    self._order(controller_command_t.RECOVER, "recover", now)
                else:
                    self.note = "nothing to recover from"
            case Action.leave:
                self.pilot.release()
                self._leaving = self._on_leave()

    def _engage(self) -> None:
        if self.watch.running:
            self.pilot.engage(self.watch.gripper_width)
        else:
            self.note = "no episode is running; nothing to take"

    def _label(self, verdict: int) -> None:
        if self.watch.running:
            self.pilot.label(verdict, self.watch.status.episode)
            self.note = f"episode {self.watch.status.episode}: {VERDICTS[verdict]}"
        else:
            self.note = "no episode is running; nothing to label"

    def _order(self, order: int, reason: str, now: float) -> None:
        before = None if self.watch.silent else self.watch.status
        self._orders[order] = Order(order, f"{reason} by {self.pilot.operator_id}", before, now)

    def _hear_status(self, status: Any) -> None:
        if self.training:
            self.training.on_status(status)
        if self._episode != status.episode:
            self._episode = status.episode
            self.pilot.begin_episode(status.episode, status.phase)
        if self.watch.halted and self.pilot.engaged:
            self.pilot.release()
            self.note = "the arm has stopped; let go"

    # ---- showing, ending

    def _draw(self, live: Live | None, console: Console, now: float) -> None:
        view = screen.View(
            title=self._title,
            engaged=self.pilot.engaged,
            speed=self.pilot.speed,
            held=self.device.describe(now),
            note=self.note,
            warning=self.device.lost(),
            help=self.device.help,
            training=self.training.rows() if self.training else {},
        )
        try:
            if live:
                live.update(screen.panel(view, self.watch, console.encoding), refresh=True)
            else:
                print(screen.line(view, self.watch), flush=True)
        except OSError:  # the terminal is gone
            self._leaving = self._silently = True

    @contextlib.contextmanager
    def _terminal_may_go(self) -> Iterator[None]:
        try:
            yield
        except OSError:  # giving it back fails when it is gone
            if not self._silently:
                raise

    @contextlib.contextmanager
    def _ended_by_signals(self) -> Iterator[None]:
        def leave(_number: int, _frame: Any) -> None:
            self._leaving = True

        def hung_up(_number: int, _frame: Any) -> None:
            self._leaving = self._silently = True

        handlers = {signal.SIGTERM: leave, signal.SIGINT: leave, signal.SIGHUP: hung_up}
        old = {number: signal.signal(number, handler) for number, handler in handlers.items()}
        try:
            yield
        finally:
            for number, previous in old.items():
                signal.signal(number, previous)


def stop_training() -> bool:
    """Leaving a session that a training started: it ends all its programs in order, us among them."""
    os.kill(os.getppid(), signal.SIGINT)
    return False
