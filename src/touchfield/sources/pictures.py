"""Pictures with one number a pixel (PNG, TIFF, PGM, NPY) as arrays; a bad file is one clear error.

Sources: the PNG specification (IHDR), NumPy's NPY format; PNG and TIFF samples are decoded by Pillow. The size is
read from the header and bounded before anything is decoded, because pictures come from strangers.
"""

from __future__ import annotations

import math
import re
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import SourceError
from touchfield.files import require_plain

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from PIL import Image

__all__ = [
    "MAX_PIXELS",
    "PICTURE_SUFFIXES",
    "PictureHeader",
    "bound_pixels",
    "picture_header",
    "read_npy_stream",
    "read_picture",
]

MAX_PIXELS: Final = 1 << 26
"""Pixels of the largest picture that is decoded (8192 x 8192)."""

PICTURE_SUFFIXES: Final = (".png", ".tif", ".tiff", ".npy")

_MAX_EXPANSION: Final = 1400
"""Bytes out of one byte in: deflate reaches 1032, LZW of TIFF about 1366."""

_PNG_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS: Final = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_PIL_SAMPLES: Final = {
    "L": "uint8", "I;16": "uint16", "I;16L": "uint16", "I;16B": "uint16", "I;16N": "uint16", "I": "int32",
    "F": "float32",
}  # fmt: skip
_PGM_HEADER: Final = re.compile(rb"P5\s" + 2 * rb"(?:#[^\n]*\n|\s)*(\d{1,6})\s" + rb"(?:#[^\n]*\n|\s)*(\d{1,5})\s")
_PGM_HEADER_BYTES: Final = 512
_NPY_MAGIC: Final = b"\x93NUMPY"
_NPY_HEADER: Final = re.compile(
    rb"\{\s*'descr':\s*'([<>|=]?(?:[ui][1248]|f[248]))',\s*'fortran_order':\s*(True|False),"
    rb"\s*'shape':\s*\(((?:\s*\d{1,10}\s*,?)*)\s*\),?\s*\}\s*"
)


@dataclass(frozen=True)
class PictureHeader:
    """What the first bytes of a picture say.

    Attributes
    ----------
    width, height : int
        Pixels.
    sample : str
        NumPy's name of the type of a sample, for example "uint16"; "" for one that is not read here.
    channels : int
        Samples a pixel.
    """

    width: int
    height: int
    sample: str
    channels: int

    @property
    def wording(self) -> str:
        """What it is, for a message."""
        colour = {1: "grey", 2: "grey + alpha", 3: "RGB", 4: "RGBA"}.get(self.channels, f"{self.channels}-channel")
        return f"a {colour} picture of {self.sample or 'other'} samples, {self.width} x {self.height}"


def bound_pixels(path: Path, width: int, height: int, bytes_per_pixel: int = 1) -> None:
    """Refuse a picture that has no pixels, too many, or more than its bytes can hold.

    Raises
    ------
    SourceError
        As said; before anything is allocated.
    """
    if width < 1 or height < 1:
        raise SourceError(str(path), f"a picture of {width} x {height} pixels", "at least one pixel")
    if width * height > MAX_PIXELS:
        raise SourceError(
            str(path), f"{width} x {height} pixels", f"at most {MAX_PIXELS} pixels", "Give a smaller picture."
        )
    size = path.stat().st_size
    if width * height * bytes_per_pixel > _MAX_EXPANSION * size:
        raise SourceError(
            str(path), f"{width} x {height} pixels in {size} bytes", "a whole picture", "Copy the file again."
        )


def picture_header(path: Path) -> PictureHeader:
    """Size and samples of a PNG, TIFF, PGM or NPY picture, from its header.

    Raises
    ------
    SourceError
        If the file cannot be read, is none of these, or is larger than `MAX_PIXELS`.
    """
    require_plain(path, "a picture")
    try:
        with path.open("rb") as stream:
            start = stream.read(33)
            if start.startswith(_PNG_SIGNATURE):
                header = _png_header(path, start)
            elif start.startswith(_NPY_MAGIC):
                stream.seek(0)
                shape, _, dtype = _npy_header(stream, str(path))
                header = _header_of_shape(path, shape, dtype)
            elif start.startswith(b"P5"):
                stream.seek(0)
                header, _ = _pgm_header(path, stream)
            elif start[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
                header = _tiff_header(path)
            else:
                raise SourceError(str(path), "no PNG, TIFF, PGM or NPY file", "one of these", "Check the file.")
            bound_pixels(path, header.width, header.height)
    except OSError as error:
        raise _unreadable(path, error) from error
    return header


def read_picture(path: Path) -> NDArray[Any]:
    """The samples of a PNG, TIFF, PGM or NPY picture with one number a pixel.

    Returns
    -------
    array [height, width]
        uint8, uint16, int32 or float32 for PNG, TIFF and PGM; any integer or float type for NPY. In the machine's
        byte order, C-contiguous, writeable.

    Raises
    ------
    SourceError
        If the file cannot be read, is truncated or damaged, too large, or holds colour.
    """
    header = picture_header(path)
    if header.channels != 1 or not header.sample:
        raise SourceError(str(path), header.wording, "one number a pixel, of 8 or 16 bits or float")
    try:
        with path.open("rb") as stream:
            start = stream.read(6)
            stream.seek(0)
            if start == _NPY_MAGIC:
                values = read_npy_stream(stream, path.stat().st_size, str(path))
                return values.reshape(header.height, header.width)
            if start.startswith(b"P5"):
                return _pgm_samples(path, stream)
    except OSError as error:
        raise _unreadable(path, error) from error
    return _decoded(path, header)


def read_npy_stream(stream: IO[bytes], byte_count: int, where: str) -> NDArray[Any]:
    """The array in an NPY stream of `byte_count` bytes, which bound what is allocated; never unpickles.

    Raises
    ------
    SourceError
        If it is no NPY stream, ends too early, holds something else than numbers, or is too large.
    """
    shape, fortran, dtype = _npy_header(stream, where)
    count = math.prod(shape)
    if count > 4 * MAX_PIXELS or count * dtype.itemsize > byte_count:
        raise SourceError(where, f"shape {shape} in {byte_count} bytes", "a whole array", "Copy the file again.")
    data = stream.read(count * dtype.itemsize)
    if len(data) != count * dtype.itemsize:
        raise SourceError(
            where, f"{len(data)} bytes of numbers", f"{count * dtype.itemsize} for shape {shape}", "Copy it again."
        )
    values = np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")
    return np.array(values, dtype.newbyteorder("="), order="C")


def _unreadable(path: Path, error: OSError) -> SourceError:
    return SourceError(str(path), error.strerror or str(error), "a file that can be read", "Check path and rights.")


def _png_header(path: Path, start: bytes) -> PictureHeader:
    if len(start) < 33 or start[12:16] != b"IHDR":
        raise SourceError(str(path), f"a PNG cut after {len(start)} bytes", "a whole PNG", "Copy the file again.")
    width, height, bits, colour = struct.unpack(">IIBB", start[16:26])
    channels = _PNG_CHANNELS.get(colour, 0)
    sample = f"uint{bits}" if bits in (8, 16) else ""
    if colour == 3:  # a palette: the numbers are not grey levels
        channels = 3
    return PictureHeader(width, height, sample, channels)


def _tiff_header(path: Path) -> PictureHeader:
    with _opened(path) as image:
        width, height = image.size
        return PictureHeader(width, height, _PIL_SAMPLES.get(image.mode, ""), len(image.getbands()))


def _pgm_header(path: Path, stream: IO[bytes]) -> tuple[PictureHeader, int]:
    """The header, and where the samples begin; they are as they stand, whatever the largest is said to be."""
    found = _PGM_HEADER.match(stream.read(_PGM_HEADER_BYTES))
    if found is None or not 1 <= int(found[3]) <= 65535:
        raise SourceError(str(path), "no header of a PGM", "P5, width, height and the largest sample, up to 65535")
    sample = "uint8" if int(found[3]) < 256 else "uint16"
    return PictureHeader(int(found[1]), int(found[2]), sample, 1), found.end()


def _pgm_samples(path: Path, stream: IO[bytes]) -> NDArray[Any]:
    header, start = _pgm_header(path, stream)
    kind = np.dtype(header.sample).newbyteorder(">")
    size = header.width * header.height * kind.itemsize
    if path.stat().st_size < start + size:
        raise SourceError(str(path), f"{path.stat().st_size} bytes", f"{start + size} bytes", "Copy the file again.")
    stream.seek(start)
    values = np.frombuffer(stream.read(size), kind).reshape(header.height, header.width)
    return values.astype(kind.newbyteorder("="))


def _header_of_shape(path: Path, shape: tuple[int, ...], dtype: np.dtype[Any]) -> PictureHeader:
    if len(shape) == 3 and shape[2] == 1:
        shape = shape[:2]
    if len(shape) != 2:
        raise SourceError(str(path), f"an array of shape {shape}", "[height, width]", "Save one picture a file.")
    return PictureHeader(shape[1], shape[0], dtype.name, 1)


def _npy_header(stream: IO[bytes], where: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    start = stream.read(8)
    if len(start) < 8 or not start.startswith(_NPY_MAGIC) or start[6] not in (1, 2):
        raise SourceError(where, "no NPY array", "an NPY file of version 1 or 2", "Save it with numpy.save.")
    length_field = stream.read(2 if start[6] == 1 else 4)
    length = int.from_bytes(length_field, "little")
    text = stream.read(length) if length <= 1 << 16 else b""
    parsed = _NPY_HEADER.fullmatch(text)
    if parsed is None:
        raise SourceError(where, "an NPY header that does not describe numbers", "an array of numbers")
    shape = tuple(int(n) for n in parsed[3].replace(b",", b" ").split())
    return shape, parsed[2] == b"True", np.dtype(parsed[1].decode("ascii"))


def _opened(path: Path) -> Image.Image:
    """The picture opened by Pillow, not yet decoded."""
    from PIL import Image

    try:
        return Image.open(path, formats=("PNG", "TIFF"))
    except Image.DecompressionBombError as error:
        raise SourceError(str(path), "a picture that is too large", f"at most {MAX_PIXELS} pixels") from error
    except Exception as error:  # for damaged files Pillow raises almost any kind
        raise _damaged(path, error) from error


def _decoded(path: Path, header: PictureHeader) -> NDArray[Any]:
    bound_pixels(path, header.width, header.height, np.dtype(header.sample).itemsize)
    with _opened(path) as image:
        try:
            values = np.array(image)
        except Exception as error:  # as above
            raise _damaged(path, error) from error
    if values.shape != (header.height, header.width):
        raise SourceError(str(path), f"samples of shape {values.shape}", f"{(header.height, header.width)}")
    if header.sample == "uint16" and values.dtype != np.uint16:
        values = values.astype(np.uint16)  # older releases of Pillow give 16-bit PNGs as int32
    return np.ascontiguousarray(values.astype(values.dtype.newbyteorder("="), copy=False))


def _damaged(path: Path, error: Exception) -> SourceError:
    return SourceError(str(path), f"a damaged picture ({error})", "a whole PNG or TIFF", "Copy the file again.")
