"""Depth frames in one file: NPY of shape [frames, height, width], or a TIFF of several pages.

Named *depth*, as one picture of depth is (`depth_map`): an NPY of heights over time has the same shape. Floats are
metres unless a scale is given; whole numbers need one.
"""

from __future__ import annotations

import weakref
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np

from touchfield.errors import InvalidArgument, SourceError
from touchfield.medium.npz import read_npy_header
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.folder_sequence import (
    DepthCode,
    is_layout,
    opener,
    placed_sequence,
    require_scale,
    source_rate,
)
from touchfield.sources.intrinsics_file import camera_of
from touchfield.sources.pictures import bound_pixels, picture_header
from touchfield.sources.registry import SourceKind

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.sources.options import SourceOptions

__all__ = ["KIND", "DepthStack", "read_sequence"]

MAX_FRAMES: Final = 1 << 16  # of a TIFF: its pages can name each other in a ring

_TIFF: Final = (".tif", ".tiff")
_NO_DEPTH: Final = ("uint8", "int8", "bool")


class _Frames(Protocol):
    """An open file of frames."""

    sample: str
    shape: tuple[int, int, int]

    def values(self, frame: int) -> NDArray[Any]: ...


class DepthStack(DepthSequence):
    """Depth frames of one file, read when they are asked for.

    Parameters
    ----------
    name : str
        What to call it in messages.
    frames : NpyFrames or TiffFrames
    code : DepthCode
    intrinsics : Intrinsics
    rate_hz : float
    """

    def __init__(self, name: str, frames: _Frames, code: DepthCode, intrinsics: Intrinsics, rate_hz: float) -> None:
        self.name, self.frames, self.code = name, frames, code
        self.frame_count, self.height, self.width = frames.shape
        self.intrinsics, self.rate_hz = intrinsics, rate_hz

    def depth_m(self, frame: int) -> NDArray[np.float32]:
        """See `DepthSequence.depth_m`."""
        if not 0 <= frame < self.frame_count:
            raise InvalidArgument(f"{self.name}, frame", str(frame), f"0 to {self.frame_count - 1}")
        return np.ascontiguousarray(self.code.metres(self.frames.values(frame)))


class NpyFrames:
    """Frames of an NPY file, mapped into memory and not read as a whole.

    Raises
    ------
    SourceError
        If it is no whole array of numbers [frames, height, width].
    """

    def __init__(self, path: Path) -> None:
        with path.open("rb") as stream:
            header = read_npy_header(stream, str(path))
        if len(header.shape) != 3 or 0 in header.shape or header.dtype.kind not in "iuf":
            found = f"{header.dtype} of shape {header.shape}"
            raise SourceError(str(path), found, "numbers [frames, height, width]")
        size = path.stat().st_size
        if size < header.size_bytes + header.data_bytes:
            raise SourceError(str(path), f"shape {header.shape} in {size} bytes", "a whole array", "Copy it again.")
        frames, height, width = header.shape
        self.sample, self.shape = header.dtype.name, (frames, height, width)
        bound_pixels(path, width, height, header.dtype.itemsize)
        self._values = np.memmap(
            path, header.dtype, "r", header.size_bytes, header.shape, "F" if header.is_fortran else "C"
        )

    def values(self, frame: int) -> NDArray[Any]:
        """The numbers of one frame, [height, width], in the machine's byte order."""
        return np.array(self._values[frame], self._values.dtype.newbyteorder("="), order="C")


class TiffFrames:
    """Pages of a TIFF, each decoded when it is asked for.

    The file stays open: each page tells where the next one lies, so that a fresh look goes through all before it.

    Raises
    ------
    SourceError
        If it cannot be read, or its pages are not of one size and kind.
    """

    def __init__(self, path: Path) -> None:
        first = picture_header(path)
        self.path, self.sample = path, first.sample
        sizes = _page_sizes(path)
        if len(sizes) > MAX_FRAMES:
            raise SourceError(str(path), f"more than {MAX_FRAMES} pages", "a shorter sequence")
        for page, (width, height) in enumerate(sizes):
            if (width, height) != sizes[0]:
                found = f"{width} x {height} pixels"
                raise SourceError(f"{path}, page {page}", found, f"{first.width} x {first.height}, as the first page")
        self.shape = (len(sizes), first.height, first.width)
        self._lock = Lock()
        self._image: Any = None

    def values(self, frame: int) -> NDArray[Any]:
        """The numbers of one page, [height, width], in the machine's byte order."""
        where = f"{self.path}, page {frame}"
        try:
            with self._lock:
                image = self._image = self._image or self._opened()
                image.seek(frame)
                size: tuple[int, int] = image.size
                if size == (self.shape[2], self.shape[1]):
                    bound_pixels(self.path, *size, np.dtype(self.sample).itemsize)
                    values = np.array(image)
        except SourceError:
            raise
        except Exception as error:  # for damaged files Pillow raises almost any kind
            raise SourceError(where, f"a damaged page ({error})", "a whole TIFF", "Copy the file again.") from error
        if size != (self.shape[2], self.shape[1]) or values.ndim != 2 or values.dtype.name != self.sample:
            found = f"another kind of picture, {size[0]} x {size[1]} pixels"
            raise SourceError(where, found, f"{self.sample}, {self.shape[2]} x {self.shape[1]}, as the first page")
        return np.ascontiguousarray(values.astype(values.dtype.newbyteorder("="), copy=False))

    def _opened(self) -> Any:
        """The file, open until these frames are no longer used."""
        from PIL import Image

        image = Image.open(self.path, formats=("TIFF",))
        weakref.finalize(self, image.close)
        return image


def _page_sizes(path: Path, most: int = MAX_FRAMES) -> list[tuple[int, int]]:
    """Width and height of the pages of a TIFF, of at most one more than `most`."""
    from PIL import Image

    sizes: list[tuple[int, int]] = []
    try:
        with Image.open(path, formats=("TIFF",)) as image:
            while len(sizes) <= most:
                image.seek(len(sizes))
                sizes.append(image.size)
    except EOFError:  # behind the last page
        return sizes
    except Exception as error:  # as above
        raise SourceError(f"{path}, page {len(sizes)}", f"a damaged page ({error})", "a whole TIFF") from error
    return sizes


def read_sequence(path: Path, options: SourceOptions) -> DepthSequence:
    """Depth frames of one NPY or TIFF file.

    Raises
    ------
    SourceError
        If the file is at fault, holds no depth, or the scale or the intrinsics are not known.
    """
    if path.is_dir():
        raise SourceError(str(path), "a folder", "an NPY or TIFF file", "Name its kind with --as depth-folder.")
    frames: _Frames = TiffFrames(path) if path.suffix.lower() in _TIFF else NpyFrames(path)
    if frames.sample in ("", *_NO_DEPTH):
        raise SourceError(str(path), f"samples of {frames.sample or 'another kind'}", "16-bit or float depth")
    folder = path.absolute().parent
    camera = camera_of(str(path), options.intrinsics, (folder,), (frames.shape[2], frames.shape[1]))
    units_per_m = require_scale(str(path), options, frames.sample, camera)
    stack = DepthStack(str(path), frames, DepthCode(units_per_m), camera.intrinsics, source_rate(options))
    return placed_sequence(stack, options, (folder,), camera)


def _recognise(path: Path) -> bool:
    if "depth" not in path.name.lower() or not path.is_file():
        return False
    if path.suffix.lower() == ".npy":
        with path.open("rb") as stream:
            shape = read_npy_header(stream, str(path)).shape
        return len(shape) == 3 and shape[2] != 1
    if path.suffix.lower() not in _TIFF or picture_header(path).channels != 1:
        return False
    sizes = _page_sizes(path, most=2)
    return len(sizes) > 1 and sizes[1] == sizes[0]  # an elevation model keeps smaller copies of itself as pages


KIND = SourceKind(
    "depth-stack",
    "depth frames in one file named *depth*: NPY [frames, height, width] in metres, or a TIFF of several pages",
    is_layout(_recognise),
    opener(read_sequence),
)
