"""MCAP: every message as JSON with a schema, for Foxglove, PlotJuggler and mcap's own tools.

Beside the channels of the log, `tf` holds the poses of tool, reference, object and goal as foxglove.FrameTransforms,
which Foxglove's 3D panel draws, and `camera` the images that the policy saw as foxglove.CompressedImage. The scenario
lies in the file as an attachment.
"""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer
from pydantic_core import to_json

from tandem import __version__
from tandem.export.message import json_schema
from tandem.export.source import Source, whole_or_not_at_all
from tandem.log.fields import as_json
from tandem.wire import CHANNELS

BASE_FRAME = "base"
# channel -> (frame, position, orientation): poses in W that a message carries
POSES = {
    "ROBOT_STATE": [
        ("tool", "p_WE_measured", "q_WE_measured"),
        ("reference", "p_WE_reference", "q_WE_reference"),
    ],
    "WORLD_STATE": [("object", "p_WO", "q_WO"), ("goal", "p_WG", "q_WG")],
}


def _of(names: str, kind: str) -> dict[str, Any]:
    return {"type": "object", "properties": {name: {"type": kind} for name in names.split()}}


# as Foxglove publishes it: https://docs.foxglove.dev/docs/sdk/schemas/frame-transforms
FRAME_TRANSFORMS = {
    "title": "foxglove.FrameTransforms",
    "type": "object",
    "properties": {
        "transforms": {
            "type": "array",
            "items": {
                "type": "object",
                "title": "foxglove.FrameTransform",
                "properties": {
                    "timestamp": {"title": "time", **_of("sec nsec", "integer")},
                    "parent_frame_id": {"type": "string"},
                    "child_frame_id": {"type": "string"},
                    "translation": {"title": "foxglove.Vector3", **_of("x y z", "number")},
                    "rotation": {"title": "foxglove.Quaternion", **_of("x y z w", "number")},
                },
            },
        }
    },
}

# https://docs.foxglove.dev/docs/sdk/schemas/compressed-image
COMPRESSED_IMAGE = {
    "title": "foxglove.CompressedImage",
    "type": "object",
    "properties": {
        "timestamp": {"title": "time", **_of("sec nsec", "integer")},
        "frame_id": {"type": "string"},
        "data": {"type": "string", "contentEncoding": "base64"},
        "format": {"type": "string"},
    },
}


def write(source: Source, path: Path) -> dict[str, int]:
    with whole_or_not_at_all(path) as partial, partial.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="", library=f"tandem {__version__}")
        _add_origin(writer, source)
        channels: dict[str, int] = {}
        n_messages = 0
        for number, event in enumerate(source.messages()):
            if event.channel not in channels:
                message_name = CHANNELS[event.channel].__name__
                channels[event.channel] = _register(
                    writer, event.channel, f"tandem.{message_name}", json_schema(message_name)
                )
            writer.add_message(
                channel_id=channels[event.channel],
                log_time=1000 * event.timestamp,
                publish_time=1000 * event.message.utime,
                sequence=number,
                data=as_json(event.message),
            )
            n_messages += 1
            if event.channel == "EPISODE_STEP" and event.message.n_image:
                if "camera" not in channels:
                    name = "foxglove.CompressedImage"
                    channels["camera"] = _register(writer, "camera", name, COMPRESSED_IMAGE)
                time = 1000 * event.message.utime  # when it was seen, not when the episode was over
                data = _image(event.message.image, time)
                writer.add_message(channel_id=channels["camera"], log_time=time, publish_time=time, data=data)
            if poses := POSES.get(event.channel):
                if "tf" not in channels:
                    channels["tf"] = _register(writer, "tf", "foxglove.FrameTransforms", FRAME_TRANSFORMS)
                time = 1000 * event.timestamp
                data = _transforms(event.message, time, poses)
                writer.add_message(channel_id=channels["tf"], log_time=time, publish_time=time, data=data)
        writer.finish()
    return {"episodes": len(source.ends), "messages": n_messages, "channels": len(channels)}


def _register(writer: Writer, topic: str, name: str, schema: dict[str, Any]) -> int:
    schema_id = writer.register_schema(name=name, encoding="jsonschema", data=json.dumps(schema).encode())
    return writer.register_channel(topic=topic, message_encoding="json", schema_id=schema_id)


def _add_origin(writer: Writer, source: Source) -> None:
    run = source.scenario["run"]
    facts = {name: str(run[name]) for name in ("task", "method", "seed", "clock")}
    writer.add_metadata("tandem", facts | {"git_revision": source.made_from.git_revision})
    text = source.made_from.scenario_yaml.encode()
    writer.add_attachment(0, 0, "scenario.yaml", "application/yaml", text)


def _image(jpeg: bytes, time: int) -> bytes:
    stamp = {"sec": time // 10**9, "nsec": time % 10**9}
    data = base64.b64encode(jpeg).decode()
    return to_json({"timestamp": stamp, "frame_id": "wrist", "data": data, "format": "jpeg"})


def _transforms(message: Any, time: int, poses: list[tuple[str, str, str]]) -> bytes:
    stamp = {"sec": time // 10**9, "nsec": time % 10**9}
    transforms = []
    for frame, position, orientation in poses:
        x, y, z = getattr(message, position)
        w, i, j, k = getattr(message, orientation)
        transforms.append(
            {
                "timestamp": stamp,
                "parent_frame_id": BASE_FRAME,
                "child_frame_id": frame,
                "translation": {"x": x, "y": y, "z": z},
                "rotation": {"x": i, "y": j, "z": k, "w": w},
            }
        )
    return to_json({"transforms": transforms})
