"""Opens contacts in MATLAB files (version 5, ``.mat``): arrays of structures with the fields pos and F.

Source of the layout: the Panda co-manipulation dataset (`touchfield data show panda-co-manipulation`): pos in
metres and F in newtons, 3 x T each. F is taken as the force on the probe. The first recording of a file is
read: several contradict each other, since the same place is pressed differently each time.
"""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import SourceError, reason
from touchfield.files import read_bytes
from touchfield.medium.trace import MAX_SAMPLES, ContactTrace
from touchfield.sources.options import SourceOptions
from touchfield.sources.recordings.contact_trace import ContactScene, require_world_frame
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import Scene

_EXPECTED: Final = "a MATLAB 5 file with structures of pos and F, 3 x T each"
_MAX_BYTES: Final = 1 << 26
_MAX_UNPACKED: Final = 1 << 28
_CHUNK: Final = 1 << 20
_HEAD: Final = b"MATLAB 5.0 MAT-file"
_HEAD_BYTES: Final = 128
_COMPRESSED: Final = 15  # data type miCOMPRESSED
_FIELDS: Final = ("pos", "F")


def _require_bounded(path: Path, data: bytes) -> None:
    """Raise `SourceError` if the variables unpack to more than `_MAX_UNPACKED` bytes."""
    order = ">" if data[126:128] == b"MI" else "<"
    at, total = _HEAD_BYTES, 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(order + "2I", data, at)
        part = data[at + 8 : at + 8 + size]
        total += _unpacked_size(part, _MAX_UNPACKED - total + 1) if kind == _COMPRESSED else len(part)
        if total > _MAX_UNPACKED:
            raise SourceError(str(path), f"more than {_MAX_UNPACKED} bytes, unpacked", _EXPECTED)
        at += 8 + size


def _unpacked_size(part: bytes, limit: int) -> int:
    """Return the size of compressed bytes, or if it is larger a size of at least `limit`."""
    unpacker, size = zlib.decompressobj(), 0
    while part and size < limit and not unpacker.eof:
        size += len(unpacker.decompress(part, _CHUNK))
        part = unpacker.unconsumed_tail
    return size


def read_matlab_contacts(path: Path) -> tuple[ContactTrace, tuple[str, ...]]:
    """Read the contacts of the first structure with pos and F, and notes on what is not read.

    Raises `SourceError` if the file cannot be read or is too large, there is no such structure, or a number
    is not finite.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    data = read_bytes(path, _MAX_BYTES, _EXPECTED)
    if not data.startswith(_HEAD):
        raise SourceError(str(path), "no MATLAB 5 file", _EXPECTED, "In MATLAB: save(FILE, '-v7').")
    try:
        _require_bounded(path, data)
        variables = loadmat(io.BytesIO(data))
    except SourceError:
        raise
    except (MatReadError, zlib.error, ValueError, TypeError, KeyError, OSError, MemoryError) as error:
        raise SourceError(
            str(path), f"a damaged file ({reason(error)})", _EXPECTED, "Copy it again."
        ) from error
    parts, others = _recordings(path, variables)
    if not parts:
        listed = ", ".join(others[:6]) or "no variable"
        raise SourceError(str(path), listed, _EXPECTED)
    if len(parts[0].positions_m) > MAX_SAMPLES:
        found = f"{len(parts[0].positions_m)} samples"
        raise SourceError(str(path), found, f"at most {MAX_SAMPLES}", "Cut it.")
    notes: tuple[str, ...] = ("F is taken as the force on the probe.",)
    if len(parts) > 1:
        notes += (f"Recording 1 of {len(parts)} is read: each is a contact of its own.",)
    if others:
        notes += (f"Not used: {', '.join(others[:6])}.",)
    return parts[0], notes


def _recordings(path: Path, variables: dict[str, Any]) -> tuple[list[ContactTrace], list[str]]:
    """Return the recordings of all variables, and the names of what is not used."""
    parts: list[ContactTrace] = []
    others: list[str] = []
    for name, value in variables.items():
        if name.startswith("__"):
            continue
        fields = getattr(getattr(value, "dtype", None), "names", None) or ()
        if not set(_FIELDS) <= set(fields):
            others.append(name)
            continue
        others += [f"{name}.{field}" for field in fields if field not in _FIELDS]
        for n, row in enumerate(value.reshape(-1), 1):
            where = f"{path}: {name}({n})"
            pair = [_columns(row[field], f"{where}.{field}") for field in _FIELDS]
            if len(pair[0]) != len(pair[1]):
                found = f"{len(pair[0])} positions and {len(pair[1])} forces"
                raise SourceError(where, found, "as many of both")
            parts.append(ContactTrace(pair[0], pair[1]))
    return parts, others


def _columns(value: object, where: str) -> Float64s:
    """Return a 3 x T array as float64 [T, 3]."""
    array = np.asarray(value)
    if array.ndim != 2 or array.shape[0] != 3 or array.dtype.kind not in "iuf":
        raise SourceError(where, f"{array.dtype.name} of shape {array.shape}", "numbers, 3 x T")
    rows = array.T.astype(np.float64)
    if not np.isfinite(rows).all():
        raise SourceError(where, "a number that is not finite", "finite metres and newtons")
    return rows


def _recognise(path: Path) -> bool:
    return path.suffix.lower() == ".mat" and path.is_file()


def _open(path: Path, options: SourceOptions) -> Scene:
    require_world_frame(options, "a recording")
    trace, notes = read_matlab_contacts(path)
    return ContactScene(trace, str(path), notes)


KIND = SourceKind(
    "matlab-contacts",
    "recorded contacts in a MATLAB 5 file: structures with pos (m) and F (N), 3 x T",
    _recognise,
    _open,
)
