"""One table without a terminal: for pipes, scripts and CI."""

import time
from typing import Any

from tandem.spy.channel_table import as_json
from tandem.spy.live import LiveSource
from tandem.spy.model import Model
from tandem.spy.recording import Recording, whole

POLL_S = 0.2


def listen(source: LiveSource, model: Model, seconds: float) -> None:
    """Takes in what comes for so long."""
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        time.sleep(min(POLL_S, left))
        model.take(source.poll())


def read(recording: Recording, model: Model) -> None:
    """Takes in a whole log, every message judged."""
    for batch in whole(recording):
        model.take(batch, decoded=None)


def figures(source: str, model: Model) -> dict[str, Any]:
    """What --json writes."""
    rows = model.rows()
    return {
        "source": source,
        "seconds": model.elapsed_s,
        "messages": sum(row.count for row in rows),
        "gaps": sum(row.gaps or 0 for row in rows),
        "undecodable": sum(row.undecodable for row in rows),
        "channels": as_json(rows),
    }
