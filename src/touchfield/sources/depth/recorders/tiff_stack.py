"""A TIFF of several pages as depth frames (ImageJ, tifffile, scikit-image): a file named *depth*.

Pages are of 16 bits (needs --depth-scale) or floats in metres, of one size. Camera and poses are found as for
other single files.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.errors import SourceError
from touchfield.sources.camera import require_frame
from touchfield.sources.depth.layouts import Layout, PictureSet
from touchfield.sources.images.pictures import (
    bound_pixels,
    has_pages,
    opened,
    picture_header,
    require_all_strips,
    require_size,
)

_MAX_PAGES: Final = 1 << 16


class TiffPages:
    """The pages of a TIFF as frames, read on demand (`camera.Frames`)."""

    def __init__(self, path: Path) -> None:
        header = picture_header(path)
        if header.channels != 1 or header.sample in ("", "uint8", "int8"):
            mend = "Save the depth itself, with 16 bits or as floats."
            raise SourceError(str(path), header.wording, "16-bit (or float) grey depth", mend)
        with opened(path, ("TIFF",)) as image:
            self.frame_count = int(image.n_frames)
        if self.frame_count > _MAX_PAGES:
            raise SourceError(str(path), f"{self.frame_count} pages", f"at most {_MAX_PAGES}")
        self.paths, self.headers, self.size = (path,), (header,), header[:2]

    def values(self, frame: int) -> NDArray[Any]:
        """See ``camera.Frames``."""
        require_frame(frame, self.frame_count)
        path, where = self.paths[0], f"{self.paths[0]}, page {frame + 1}"
        with opened(path, ("TIFF",)) as image:
            image.seek(frame)
            require_size(where, image.size, self.size, "as the first page has")
            bound_pixels(path, *image.size)
            require_all_strips(where, image)
            values = np.array(image)
        kind = np.dtype(self.headers[0].sample)
        if values.ndim != 2 or values.dtype.newbyteorder("=") != kind:
            raise SourceError(
                where, f"{values.dtype} samples {values.shape}", f"grey {kind}, as the first page"
            )
        return np.array(values, kind, order="C")


def _open(path: Path) -> PictureSet:
    folder = (path.absolute().parent,)
    return PictureSet((), path, folder, folder, file_frames=TiffPages(path))


def _recognise(path: Path) -> bool:
    is_named = "depth" in path.name.lower() and path.suffix.lower() in (".tif", ".tiff")
    return is_named and path.is_file() and has_pages(path)


LAYOUT: Final = Layout(
    "depth-tiff",
    "depth frames in a TIFF of several pages named *depth*: 16 bits (needs --depth-scale), floats in metres",
    _recognise,
    _open,
    is_file=True,
)
KIND: Final = LAYOUT.kind
