"""Small videos, written with PyAV for the tests that read them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np


def write_video(
    path: Path, frames: np.ndarray, pixels: str, codec: str = "ffv1", rate: int = 25, **options: str
) -> Path:
    """Frames [n, height, width] (or [n, height, width, 3] for "rgb24") as one video stream."""
    import av

    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream(codec, rate=rate, options=options)
        stream.height, stream.width = frames.shape[1:3]
        stream.pix_fmt = pixels
        source_format = {"gray16be": "gray16le", "yuv420p": "rgb24", "bgr0": "rgb24"}.get(pixels, pixels)
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format=source_format)))
        container.mux(stream.encode())
    return path


def depths_mm(frames: int = 20, height: int = 30, width: int = 40) -> np.ndarray:
    """Millimetres, uint16 [frames, height, width]: a receding wall with noise and two outliers."""
    noise = np.random.default_rng(4).integers(0, 9, (frames, height, width))
    slope = 800 + 7 * np.arange(height)[:, None] + 5 * np.arange(width)
    depth = (slope + noise + 11 * np.arange(frames)[:, None, None]).astype(np.uint16)
    depth[:, 2, 3], depth[:, 4, 5] = 0, 65535
    return depth
