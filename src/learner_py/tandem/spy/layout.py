"""What a message is, from its bytes: its type by the fingerprint, numbers at its head without decoding the rest."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from tandem.log.layout import FINGERPRINT, head
from tandem.wire import CHANNELS

FINGERPRINT_BYTES = 8


@dataclass(frozen=True)
class Sequence:
    """Where a message carries its number."""

    member: str  # counts up by 1, or by the same number each time
    group: str | None  # the count starts anew when this member changes; below 0 it does not count


SEQUENCES = {
    "robot_state_t": Sequence("tick", "episode"),
    "control_tick_t": Sequence("tick", "episode"),
    "world_state_t": Sequence("step", "episode"),
    "action_chunk_t": Sequence("chunk_id", "episode"),
    "episode_step_t": Sequence("step", "episode"),
    "episode_end_t": Sequence("episode", None),
}


@dataclass(frozen=True)
class Layout:
    """A message type, and where its leading members of fixed size lie."""

    message_type: Any
    members: dict[str, tuple[int, np.dtype[Any]]]  # name -> (offset, type), up to the first of variable size
    size: int | None  # bytes of every message, None when it varies

    @property
    def name(self) -> str:
        return str(self.message_type.__name__)

    @property
    def sequence(self) -> Sequence | None:
        return SEQUENCES.get(self.name)

    def read(self, member: str, data: list[bytes]) -> np.ndarray:
        """A leading whole number of each message, int64; the messages are long enough."""
        offset, dtype = self.members[member]
        joined = b"".join([item[offset : offset + dtype.itemsize] for item in data])
        return np.frombuffer(joined, dtype).astype(np.int64)

    def decodes(self, data: bytes) -> bool:
        """Whether these bytes are a message of this type. Costs a decoding when its size varies."""
        return len(data) >= self.size if self.size is not None else self.decode(data) is not None

    def decode(self, data: bytes) -> Any | None:
        """The message, None when the bytes are none of this type."""
        try:
            return self.message_type.decode(data)
        except (
            Exception
        ):  # the generated code has no error of its own: struct.error, ValueError, MemoryError ...
            return None


@cache
def of_fingerprint(fingerprint: bytes) -> Layout | None:
    """The type of a message that begins with these eight bytes, None when it is not ours."""
    return _layouts().get(fingerprint)


@cache
def _layouts() -> dict[bytes, Layout]:
    return {t._get_packed_fingerprint(): _layout(t) for t in CHANNELS.values()}  # type: ignore[attr-defined]


def _layout(message_type: Any) -> Layout:
    dtype, whole = head(message_type)
    fields: Any = dtype.fields or {}
    members = {name: (offset, kind) for name, (kind, offset, *_) in fields.items() if not kind.shape}
    del members[FINGERPRINT]
    return Layout(message_type, members, dtype.itemsize if whole else None)
