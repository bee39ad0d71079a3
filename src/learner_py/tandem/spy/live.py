"""Messages from LCM as they come: a thread that does nothing but take them in."""

import threading
import time
from pathlib import Path
from typing import Any

from tandem.processes import receive_buffer
from tandem.spy.model import Batch
from tandem.wire import Wire

PATIENCE_S = 0.1


class LiveSource:
    """Hears every channel of an address. The clock is the machine's monotonic one, as that of `utime`.

    @raises RuntimeError with a sentence when LCM does not open.
    """

    refresh_s = 0.5  # of the view

    def __init__(self, url: str) -> None:
        self.title = url
        self._wire = Wire(_with_buffer(url))
        self._inbox: dict[str, tuple[list[int], list[bytes]]] = {}
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._wire.subscribe_raw(".*", self._receive)
        self._thread = threading.Thread(target=self._listen, name="spy-receive", daemon=True)
        self._thread.start()

    def _receive(self, channel: str, data: bytes) -> None:
        with self._lock:
            entry = self._inbox.get(channel)
            if entry is None:
                entry = self._inbox[channel] = ([], [])
            entry[0].append(time.monotonic_ns() // 1000)
            entry[1].append(data)

    def _listen(self) -> None:
        while not self._ended.is_set():
            self._wire.handle_one(PATIENCE_S)

    def poll(self) -> Batch:
        """What came since the last call."""
        with self._lock:
            inbox, self._inbox = self._inbox, {}
        return Batch(time.monotonic_ns() // 1000, inbox, live=True)

    def close(self) -> None:
        self._ended.set()
        self._thread.join(timeout=10 * PATIENCE_S)


def _with_buffer(url: str) -> str:
    """Asks for a socket buffer that outlasts a busy moment, where the address leaves it open."""
    if not url.startswith("udpm://") or "recv_buf_size" in url:
        return url
    return f"{url}{'&' if '?' in url else '?'}recv_buf_size={receive_buffer()}"


def evaluations(folder: Path | None) -> list[dict[str, Any]]:
    """Results of the checkpoints that a run folder holds by now, ascending by env steps."""
    import json

    found = []
    for file in sorted((folder / "evaluations").glob("[0-9]*.json")) if folder else []:
        try:
            value = json.loads(file.read_text())
            found.append({key: value[key] for key in ("env_steps", "successes", "episodes")})
        except (OSError, ValueError, KeyError):
            continue
    return sorted(found, key=lambda value: value["env_steps"])
