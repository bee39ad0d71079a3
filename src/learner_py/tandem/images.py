"""JPEG of the camera -> pixels; the same that the controller's policy saw."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

Pixels = NDArray[np.uint8]


def decode(jpeg: bytes) -> Pixels:
    """(H, W, 3) RGB. Raises ValueError with a sentence."""
    try:
        with Image.open(io.BytesIO(jpeg), formats=["JPEG"]) as image:
            return np.asarray(image.convert("RGB"))
    except (UnidentifiedImageError, OSError) as error:
        raise ValueError(f"An image of {len(jpeg)} bytes is no JPEG ({error}); the log is damaged.") from None


def decode_all(jpegs: Sequence[bytes]) -> Pixels:
    """(N, H, W, 3) RGB. Raises ValueError when they are not of one size."""
    pixels = [decode(jpeg) for jpeg in jpegs]
    sizes = sorted({image.shape for image in pixels})
    if len(sizes) > 1:
        shown = ", ".join(f"{width} x {height} px" for height, width, _ in sizes)
        raise ValueError(f"Images of one episode have different sizes: {shown}; all must agree.")
    return np.stack(pixels)
