"""Pictures of confidence beside depth pictures, as phones with a lidar record them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from touchfield.sources.images.pictures import read_picture, require_size


def confident_reader(
    confidence_of: Callable[[Path], Path], min_confidence: int
) -> Callable[[Path], NDArray[Any]]:
    """Return a reader of depth pictures that makes pixels of too little confidence unknown (0).

    ``confidence_of(path)`` is the picture of confidence, 8 bits, of a depth picture; without it, all pixels
    are used. Raises `SourceError` if its size is not that of the depth.
    """

    def read(path: Path) -> NDArray[Any]:
        values = read_picture(path)
        file = confidence_of(path)
        if file.is_file():
            confidence = read_picture(file)
            require_size(str(file), confidence.shape[::-1], values.shape[::-1], f"as in {path.name}")
            values[confidence < min_confidence] = 0
        return values

    return read
