"""Reduces a decoded frame of a video to a small RGB picture, each pixel the mean over those it stands for.

The planes of luminance and colour differences are reduced first, and only the small picture becomes RGB: both
steps are linear apart from rounding, and most of the time of the other order went into pixels that a mean
discards.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

_SMALL_FORMATS: Final = {
    **dict.fromkeys(("yuv420p", "yuv422p", "yuv444p"), "yuv444p"),
    **dict.fromkeys(("yuvj420p", "yuvj422p", "yuvj444p"), "yuvj444p"),
}
"""FFmpeg's names of the formats with a plane of 8 bits each, and that of the small picture."""


def has_planes(picture: Any) -> bool:
    """True for a frame (``av.VideoFrame``) that `plane_means` can reduce."""
    return picture.format.name in _SMALL_FORMATS


def plane_means(picture: Any, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Reduce a frame (``av.VideoFrame``) for which `has_planes` to `size` (width, height).

    Returns sRGB, uint8 [height, width, 3].
    """
    import av

    small = av.VideoFrame(*size, _SMALL_FORMATS[picture.format.name])
    small.colorspace, small.color_range = picture.colorspace, picture.color_range
    for plane, small_plane in zip(picture.planes, small.planes, strict=True):
        rows = np.zeros((size[1], small_plane.line_size), np.uint8)
        rows[:, : size[0]] = _means(plane, size)
        small_plane.update(rows.tobytes())
    return np.asarray(small.to_ndarray(format="rgb24"), np.uint8)


def _means(plane: Any, size: tuple[int, int]) -> NDArray[np.uint8]:
    from PIL import Image

    shape = plane.width, plane.height
    image = Image.frombuffer("L", shape, plane, "raw", "L", plane.line_size, 1)
    if shape[0] % size[0] == shape[1] % size[1] == 0:  # the same means, in half the time
        return np.asarray(image.reduce((shape[0] // size[0], shape[1] // size[1])))
    return np.asarray(image.resize(size, Image.Resampling.BOX))
