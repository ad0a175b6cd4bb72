"""Reads pictures of one channel (PNG, TIFF, PGM, NPY, EXR), such as depth images, as arrays.

Sources: the PNG specification (IHDR), NumPy's NPY format; PNG and TIFF samples are decoded by Pillow. The
size is read from the header and bounded before anything is decoded, because pictures are untrusted input.
Every invalid file raises `SourceError`.
"""

from __future__ import annotations

import re
import struct
import warnings
from abc import ABC, abstractmethod
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from copy import copy
from decimal import Decimal
from itertools import islice
from pathlib import Path
from threading import Lock
from typing import IO, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.errors import SourceError, TouchfieldError
from touchfield.files import readable, require_plain
from touchfield.medium.stores.npz import map_npy, read_npy_header
from touchfield.sources.camera import require_frame
from touchfield.sources.images.exr import EXR_MAGIC, exr_size, read_exr
from touchfield.sources.images.png_rows import require_all_rows

MAX_PIXELS: Final = 1 << 26  # pixels of the largest picture that is decoded (8192 x 8192)
PICTURE_SUFFIXES: Final = (".png", ".tif", ".tiff", ".npy", ".exr")
PHOTO_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")
MAX_EXPANSION: Final = 1400  # largest compression ratio: deflate reaches 1032, LZW of TIFF about 1366
_PNG_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS: Final = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}  # palette indices are not grey levels
_PIL_SAMPLES: Final = {
    "L": "uint8", "I;16": "uint16", "I;16L": "uint16", "I;16B": "uint16", "I;16N": "uint16", "I": "int32",
    "F": "float32",
}  # fmt: skip
_PGM_HEADER: Final = re.compile(
    rb"P5\s" + 2 * rb"(?:#[^\n]*\n|\s)*(\d{1,6})\s" + rb"(?:#[^\n]*\n|\s)*(\d{1,5})\s"
)
_PGM_HEADER_BYTES: Final = 512
_NPY_MAGIC: Final = b"\x93NUMPY"
PHOTO_FORMATS: Final = ("PNG", "JPEG", "WEBP", "BMP", "TIFF")
_ORIENTATION: Final = 0x0112
_ON_ITS_SIDE: Final = (5, 6, 7, 8)
_PARTS: Final = re.compile(r"(\d+)")
_DECIMAL_PARTS: Final = re.compile(r"(\d+(?:\.\d+)?)")
_FRACTION: Final = re.compile(r"\d\.(\d+)")


# -- folders -----------------------------------------------------------------------------------------------
def list_files(folder: Path, pattern: str) -> tuple[Path, ...]:
    """List the files of a folder whose name matches a regular expression.

    They are in the order of the numbers in their names; 0.5 is before 0.56 and 0.6 where they are times, and
    1.9 before 1.10 where they are counted.
    """
    if not folder.is_dir():
        return ()
    form = re.compile(pattern, re.IGNORECASE)
    with readable(folder, "a folder that can be read"):
        files = [p for p in folder.iterdir() if form.fullmatch(p.name) and not p.name.startswith(".")]
    numbers = _PARTS if _are_counted([p.stem for p in files]) else _DECIMAL_PARTS
    natural = {
        p: [(Decimal(n), "") if n[:1].isdecimal() else (Decimal(-1), n) for n in numbers.split(p.name)]
        for p in files
    }
    return tuple(sorted(files, key=natural.__getitem__))


def _are_counted(names: Sequence[str]) -> bool:
    """Return True unless names have decimal fractions of different lengths that are no arithmetic series."""
    fractions: defaultdict[str, set[str]] = defaultdict(set)
    for name in names:
        for match in _FRACTION.finditer(name):
            fractions[name[: match.start(1)]].add(match[1])
    for texts in fractions.values():
        values = sorted(map(int, texts))
        steps = {after - before for before, after in zip(values, values[1:])}
        is_series = len(steps) <= 1 and (len(values) > 2 or steps <= {1})
        if len(set(map(len, texts))) > 1 and not is_series:
            return False
    return True


def with_suffix(*suffixes: str) -> str:
    """Return the pattern of names with one of these suffixes."""
    return r".+\.(" + "|".join(suffix[1:] for suffix in suffixes) + ")"


def has_files(folder: Path, pattern: str) -> bool:
    """Return True if a folder exists and has such a file; False if it cannot be read."""
    try:
        return bool(list_files(folder, pattern))
    except (OSError, SourceError):
        return False


def contents(folder: Path) -> str:
    """Describe a folder: "24 .png (8-bit RGB), 1 .txt, the folders colour/ poses/".

    Never raises.
    """
    try:
        entries = sorted(islice((p for p in folder.iterdir() if not p.name.startswith(".")), 10_000))
    except OSError as error:
        return error.strerror or str(error)
    files, parts = [p for p in entries if p.is_file()], []
    for suffix, count in Counter(p.suffix.lower() for p in files).most_common(5):
        samples = ""
        if suffix in PICTURE_SUFFIXES:
            with suppress(SourceError):
                samples = f" ({picture_header(next(p for p in files if p.suffix.lower() == suffix)).wording})"
        parts.append(f"{count} {suffix or 'without an ending'}{samples}")
    inner = [f"{p.name}/" for p in entries if p.is_dir()]
    if inner:
        parts.append("the folders " + " ".join(inner[:5]) + " ..." * (len(inner) > 5))
    return ", ".join(parts) or "nothing"


# -- one picture -------------------------------------------------------------------------------------------
class PictureHeader(NamedTuple):
    """Size in pixels, sample type, and number of channels of a picture.

    `sample` is NumPy's name of the type, "" if it is unsupported.
    """

    width: int
    height: int
    sample: str
    channels: int

    @property
    def wording(self) -> str:
        """Description of the header, for a message."""
        colour = {1: "grey", 2: "grey + alpha", 3: "RGB", 4: "RGBA"}.get(
            self.channels, f"{self.channels}-channel"
        )
        return f"a {colour} picture of {self.sample or 'other'} samples, {self.width} x {self.height}"


def bound_pixels(path: Path, width: int, height: int, bytes_per_pixel: int = 1) -> None:
    """Raise `SourceError` if the size of a picture is invalid.

    It is invalid if there are no pixels, too many, or more than the bytes of the file can encode.
    """
    if width < 1 or height < 1:
        raise SourceError(str(path), f"a picture of {width} x {height} pixels", "at least one pixel")
    if width * height > MAX_PIXELS:
        expected = f"at most {MAX_PIXELS} pixels"
        raise SourceError(str(path), f"{width} x {height} pixels", expected, "Give a smaller picture.")
    size = path.stat().st_size
    if width * height * bytes_per_pixel > MAX_EXPANSION * size:
        found = f"{width} x {height} pixels in {size} bytes"
        raise SourceError(str(path), found, "a whole picture", "Copy the file again.")


def require_size(where: str, size: tuple[int, ...], expected: tuple[int, int], of: str) -> None:
    """Raise `SourceError` unless a picture has the expected width and height.

    `of` describes the picture that has the expected size.
    """
    if size != expected:
        found, expected_size = f"{size[0]} x {size[1]} pixels", f"{expected[0]} x {expected[1]}, {of}"
        raise SourceError(where, found, expected_size, "Give pictures of one size.")


@contextmanager
def opened(
    path: Path, formats: tuple[str, ...] | None = None, expected: str = "a whole picture"
) -> Iterator[Any]:
    """Open a picture with Pillow, undecoded.

    Errors while it is used become `SourceError`.
    """
    from PIL import Image

    require_plain(path, "a picture")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about large pictures: callers bound the size first
            image = Image.open(path, formats=formats)
        with image:
            yield image
    except (TouchfieldError, GeneratorExit):
        raise
    except Image.DecompressionBombError as error:
        raise SourceError(str(path), "a picture that is too large", f"at most {MAX_PIXELS} pixels") from error
    except Exception as error:  # Pillow raises almost any exception for damaged files
        reason = getattr(error, "strerror", None) or error or "no picture in it"
        found = f"a picture that is damaged, or of a form that is not read ({reason})"
        raise SourceError(str(path), found, expected, "Check the file.") from error


def picture_header(path: Path) -> PictureHeader:
    """Read size and sample type of a PNG, TIFF, PGM, NPY or EXR picture from its header."""
    require_plain(path, "a picture")
    with readable(path), path.open("rb") as stream:
        start = stream.read(33)
        stream.seek(0)
        if start.startswith(_PNG_SIGNATURE):
            if len(start) < 33 or start[12:16] != b"IHDR":
                found = f"a PNG cut after {len(start)} bytes"
                raise SourceError(str(path), found, "a whole PNG", "Copy the file again.")
            width, height, bits, colour = struct.unpack(">IIBB", start[16:26])
            sample = f"uint{bits}" if bits in (8, 16) else ""
            header = PictureHeader(width, height, sample, _PNG_CHANNELS.get(colour, 0))
        elif start.startswith(_NPY_MAGIC):
            npy = read_npy_header(stream, str(path))
            shape = npy.shape[:2] if len(npy.shape) == 3 and npy.shape[2] == 1 else npy.shape
            if npy.dtype.kind not in "iuf":
                raise SourceError(str(path), f"an array of {npy.dtype}", "an array of numbers")
            if len(shape) != 2:
                raise SourceError(
                    str(path), f"an array of shape {shape}", "[height, width]", "Save one picture a file."
                )
            header = PictureHeader(shape[1], shape[0], npy.dtype.name, 1)
        elif start.startswith(b"P5"):
            header, _ = _pgm_header(path, stream)
        elif start.startswith(EXR_MAGIC):
            width, height = exr_size(path)
            header = PictureHeader(width, height, "float32", 1)
        elif start[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
            with opened(path, ("TIFF",)) as image:
                sample = _PIL_SAMPLES.get(image.mode, "")
                header = PictureHeader(image.width, image.height, sample, len(image.getbands()))
        else:
            raise SourceError(
                str(path), "no PNG, TIFF, PGM, NPY or EXR file", "one of these", "Check the file."
            )
        bound_pixels(path, header.width, header.height)
    return header


def read_picture(path: Path) -> NDArray[Any]:
    """Read the samples of a single-channel PNG, TIFF, PGM, NPY or EXR picture, [height, width].

    The type is uint8, uint16, int32 or float32 for PNG, TIFF, PGM and EXR, and any integer or float type for
    NPY.
    The array is in native byte order, C-contiguous and writeable.
    """
    header = picture_header(path)
    if header.channels != 1 or not header.sample:
        raise SourceError(str(path), header.wording, "one number a pixel, of 8 or 16 bits or float")
    size = (header.height, header.width)
    with readable(path), path.open("rb") as stream:
        start = stream.read(6)
        if start == _NPY_MAGIC:
            return _native(map_npy(path)).reshape(size)
        if start.startswith(EXR_MAGIC):
            values = read_exr(path)
            require_size(str(path), values.shape[::-1], size[::-1], "as its head says")
            return values
        if start.startswith(b"P5"):
            stream.seek(0)
            _, at = _pgm_header(path, stream)
            kind = np.dtype(header.sample).newbyteorder(">")
            needed_bytes = at + header.width * header.height * kind.itemsize
            if path.stat().st_size < needed_bytes:
                found = f"{path.stat().st_size} bytes"
                raise SourceError(str(path), found, f"{needed_bytes} bytes", "Copy the file again.")
            stream.seek(at)
            return _native(np.frombuffer(stream.read(needed_bytes - at), kind).reshape(size))
    bound_pixels(path, header.width, header.height, np.dtype(header.sample).itemsize)
    with opened(path, ("PNG", "TIFF")) as image:
        require_all_strips(str(path), image)
        values = np.array(image)
        if image.format == "PNG":
            _require_whole_png(path, values)
    if values.shape != size:
        raise SourceError(str(path), f"samples of shape {values.shape}", f"{size}")
    if header.sample == "uint16" and values.dtype != np.uint16:
        values = values.astype(np.uint16)  # older releases of Pillow give 16-bit PNGs as int32
    return _native(values)


def _require_whole_png(path: Path, values: NDArray[Any]) -> None:
    with path.open("rb") as stream:
        require_all_rows(str(path), stream, values)


def require_all_strips(where: str, image: Any) -> None:
    """Raise `SourceError` for a picture of Pillow whose strips or tiles do not cover it.

    Pillow fills the rest with zeros, so that a small TIFF could state a picture of any size.
    """
    width, height = image.size
    covered = sum((right - left) * (low - top) for _, (left, top, right, low), *_ in image.tile)
    if covered < width * height:
        found = f"strips or tiles of {covered} pixels"
        raise SourceError(where, found, f"all {width * height} of them", "Copy the file again.")


def _pgm_header(path: Path, stream: IO[bytes]) -> tuple[PictureHeader, int]:
    """Read the header and the offset of the samples, which are not rescaled by the stated maximum."""
    match = _PGM_HEADER.match(stream.read(_PGM_HEADER_BYTES))
    if match is None or not 1 <= int(match[3]) <= 65535:
        raise SourceError(
            str(path), "no header of a PGM", "P5, width, height and the largest sample, up to 65535"
        )
    sample = "uint8" if int(match[3]) < 256 else "uint16"
    return PictureHeader(int(match[1]), int(match[2]), sample, 1), match.end()


def read_map(path: Path) -> NDArray[Any]:
    """Read a picture like `read_picture`, or an 8-bit RGB PNG whose channels are equal."""
    header = picture_header(path)
    if (header.channels, header.sample) != (3, "uint8"):
        return read_picture(path)
    bound_pixels(path, header.width, header.height, 3)
    with opened(path, ("PNG",)) as image:
        channels = np.asarray(image.convert("RGB"))
        _require_whole_png(path, channels)
    if (channels != channels[:, :, :1]).any():
        mend = "Save the relative depth itself, not a coloured preview."
        raise SourceError(str(path), "a picture in colour", "the grey map", mend)
    return np.ascontiguousarray(channels[:, :, 0])


def photo_size(path: Path) -> tuple[int, int]:
    """Read width and height of a photograph as displayed, from its header.

    Raises `SourceError` if the file is in none of the formats `PHOTO_FORMATS`.
    """
    with opened(path, PHOTO_FORMATS, "PNG, JPEG, WebP, BMP or TIFF") as image:
        width, height = image.size
        is_on_its_side = image.getexif().get(_ORIENTATION) in _ON_ITS_SIDE
    return (height, width) if is_on_its_side else (width, height)


def _native(values: NDArray[Any]) -> NDArray[Any]:
    return np.array(values, values.dtype.newbyteorder("="), order="C")


# -- frames (`camera.Frames`) ------------------------------------------------------------------------------
class PictureFrames:
    """Frames in files of one size, one file for each frame, read on demand by `read`."""

    def __init__(self, paths: Sequence[Path], read: Callable[[Path], NDArray[Any]] = read_picture) -> None:
        self._read = read
        self.headers = tuple(map(picture_header, paths))
        self.paths, self.frame_count, self.size = tuple(paths), len(paths), self.headers[0][:2]
        for path, header in zip(self.paths, self.headers):
            require_size(str(path), header[:2], self.size, f"as in {paths[0].name}")
            if path.suffix.lower() in (".tif", ".tiff") and has_pages(path):
                mend = "Save the pages as one array, NPY [frames, height, width]."
                raise SourceError(str(path), "a TIFF of several pages", "one picture in a file", mend)

    def only(self, indices: Sequence[int]) -> PictureFrames:
        """Return the frames with these indices."""
        selected = copy(self)
        selected.paths, selected.headers = (
            tuple(self.paths[i] for i in indices),
            tuple(self.headers[i] for i in indices),
        )
        selected.frame_count = len(indices)
        return selected

    def values(self, frame: int) -> NDArray[Any]:
        values = self._read(self.paths[frame])
        require_size(str(self.paths[frame]), values.shape[::-1], self.size, f"as in {self.paths[0].name}")
        return values


class ArrayFrames:
    """Frames of an array [frames, height, width].

    The array may be memory-mapped from the file `path`.
    """

    def __init__(self, values: NDArray[Any], path: Path | None = None) -> None:
        if values.ndim != 3:
            raise SourceError(
                str(path), f"{values.dtype} of shape {values.shape}", "numbers [frames, height, width]"
            )
        self._values = values
        self.frame_count, height, width = values.shape
        self.paths, self.headers = (path,), (PictureHeader(width, height, values.dtype.name, 1),)
        self.size = width, height
        if path:
            bound_pixels(path, width, height, values.dtype.itemsize)

    def values(self, frame: int) -> NDArray[Any]:
        return _native(self._values[frame])


def has_pages(path: Path) -> bool:
    """Return True if the second page of a TIFF is as large as the first.

    Smaller ones are overviews.
    """
    with suppress(SourceError), opened(path, ("TIFF",)) as image:
        size = image.size
        image.seek(1)
        return bool(image.size == size)
    return False


class InOrder(ABC):
    """Arrays over time that are computed in order.

    A pass in order computes each array once; the latest one is cached.
    """

    def __init__(self, name: str, frame_count: int) -> None:
        self.name, self.frame_count = name, frame_count
        self._iterator: Iterator[NDArray[Any]] = iter(())
        self._next = -1  # number of the next frame; -1: not started, or failed
        self._latest: tuple[int, NDArray[Any]] | None = None
        self._lock = Lock()

    def _decode_start(self, frame: int) -> int:
        """Return the last frame up to this one at which decoding can start."""
        return 0

    @abstractmethod
    def _iterate(self, first: int) -> Iterator[NDArray[Any]]:
        """Yield the arrays from frame `first` on, at which decoding can start."""

    def at(self, frame: int) -> NDArray[Any]:
        """Return the array of a frame, which must not be changed."""
        require_frame(frame, self.frame_count, self.name)
        with self._lock:
            if self._latest is None or self._latest[0] != frame:
                first, where = self._decode_start(frame), f"{self.name}, frame {frame}"
                if not first <= self._next <= frame:
                    self._next, self._iterator = first, self._iterate(first)
                for number in range(self._next, frame + 1):
                    self._next = -1  # until the frame is available
                    try:
                        array = next(self._iterator)
                    except StopIteration:
                        expected = f"{self.frame_count} frames"
                        raise SourceError(where, "no more frames", expected, "Copy the file again.") from None
                    except SourceError as error:
                        if error.where != self.name:
                            raise
                        raise SourceError(where, error.found, error.expected, error.hint) from error
                    self._next = number + 1
                self._latest = frame, array
            return self._latest[1]

    def values(self, frame: int) -> NDArray[Any]:
        """Return a copy of the array of a frame; see ``camera.Frames``."""
        return self.at(frame).copy()
