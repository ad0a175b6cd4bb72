"""Reads the points of a PCD file of the Point Cloud Library: ascii, binary and binary_compressed (LZF).

Source: the PCD file format, https://pointclouds.org/documentation/tutorials/pcd_file_format.html. A
compressed file holds each field of all points in turn. The viewpoint is where the points were seen from; one
that is not set, at the origin, is used only for a cloud in rows and columns, as of a camera.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.sources.clouds.cloud import Cloud, require_points
from touchfield.sources.clouds.ply_points import columns, lines_of
from touchfield.sources.scene import CAMERA_AXES, UP_Y_AXES

_MAX_HEADER: Final = 1 << 16
_KINDS: Final = {"F": "f", "I": "i", "U": "u"}
_NORMALS: Final = ("normal_x", "normal_y", "normal_z")
_UNSEEN: Final = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
_MAX_RATIO: Final = 264  # bytes out of each byte in; LZF copies 264 for 3
_MAX_BYTES_PER_FIELD: Final = 1 << 12


def read_pcd(path: Path) -> Cloud:
    """Read the points; LookupError or ValueError if the file is not as its header says."""
    with path.open("rb") as file:
        fields, size = _header(file.read(_MAX_HEADER))
    kind = _record(fields)
    count, height = int(fields["POINTS"][0]), int(fields.get("HEIGHT", ["1"])[0])
    if count < 0:
        raise ValueError(f"{count} points")
    require_points(str(path), count)
    form = fields["DATA"][0]
    if form == "ascii":
        rows: Any = _text_rows(path, size, count, kind)
    elif form == "binary":
        _require(path.stat().st_size - size, count * kind.itemsize, count)
        rows = np.memmap(path, kind, "r", size, count) if count else np.zeros(0, kind)
    elif form == "binary_compressed":
        rows = _unpacked(path, size, count, kind)
    else:
        raise ValueError(f"DATA {form}")
    names = kind.names or ()
    if not {"x", "y", "z"} <= set(names):
        raise ValueError(f"the fields {' '.join(names)[:80]} without x, y and z")
    points = columns(rows, ("x", "y", "z"), np.dtype(np.float64))
    normals = np.zeros((0, 3), np.float32)
    if set(_NORMALS) <= set(names):
        normals = columns(rows, _NORMALS, np.dtype(np.float32))
    used = ("x", "y", "z", *_NORMALS)
    others = [name for name in names if name not in used and not name.startswith("_")]
    note = f"Fields of the points that are not used: {', '.join(others)[:120]}." if others else ""
    view = [float(value) for value in fields.get("VIEWPOINT", _UNSEEN)]
    is_seen = len(view) == 7 and (view != _UNSEEN or height > 1)
    is_camera = view == _UNSEEN and height > 1
    scanners = ((0, count, np.asarray(view[:3], np.float64)),) if is_seen else ()
    axes = CAMERA_AXES if is_camera else UP_Y_AXES
    return Cloud(points, normals, scanners, axes=axes).noted(note)


def _header(data: bytes) -> tuple[dict[str, list[str]], int]:
    """Return the entries of a header, and its size in bytes."""
    fields: dict[str, list[str]] = {}
    at = 0
    while (end := data.find(b"\n", at)) >= 0:
        words = data[at:end].decode("latin-1").split()
        at = end + 1
        if words and not words[0].startswith("#"):
            fields[words[0].upper()] = words[1:]
        if words and words[0].upper() == "DATA":
            break
    missing = [name for name in ("FIELDS", "SIZE", "TYPE", "WIDTH", "DATA") if not fields.get(name)]
    if missing:
        raise ValueError(f"a header without {', '.join(missing)}")
    if "POINTS" not in fields:
        fields["POINTS"] = [str(int(fields["WIDTH"][0]) * int(fields.get("HEIGHT", ["1"])[0]))]
    return fields, at


def _record(fields: dict[str, list[str]]) -> np.dtype[Any]:
    """Return the type of a point; fields with the same name, as of padding, get another one."""
    names, sizes, kinds = fields["FIELDS"], fields["SIZE"], fields["TYPE"]
    counts = fields.get("COUNT", ["1"] * len(names))
    if not len(names) == len(sizes) == len(kinds) == len(counts):
        raise ValueError("FIELDS, SIZE, TYPE and COUNT of different lengths")
    record: list[tuple[str, np.dtype[Any], tuple[int, ...]]] = []
    for number, (name, size, kind, count) in enumerate(zip(names, sizes, kinds, counts)):
        repeats = int(count)
        is_type = kind in _KINDS and size in ("1", "2", "4", "8") and kind + size != "F1"
        if not (is_type and 0 <= repeats <= _MAX_BYTES_PER_FIELD):
            raise ValueError(f"the field {name[:40]} of TYPE {kind[:9]}, SIZE {size[:9]}, COUNT {count[:9]}")
        is_own = name != "_" and name not in names[:number]
        shape = () if repeats == 1 else (repeats,)
        record.append((name if is_own else f"_{number}", np.dtype(f"<{_KINDS[kind]}{size}"), shape))
    return np.dtype(record)


def _require(found: int, needed: int, count: int) -> None:
    if found < needed:
        raise ValueError(f"{found} bytes where its {count} points take {needed}")


def _text_rows(path: Path, at: int, count: int, kind: np.dtype[Any]) -> NDArray[Any]:
    """Read the lines of a text as records of float64."""
    widths = [kind[name].shape[0] if kind[name].shape else 1 for name in kind.names or ()]
    _require(path.stat().st_size - at + 1, 2 * count * sum(widths), count)
    if not count:
        return np.zeros(0, kind)
    with path.open("rb") as file:
        file.seek(at)
        values = lines_of(file, max_rows=count)
    if values.shape != (count, sum(widths)):
        raise ValueError(f"{values.shape[0]} lines of {values.shape[1]} numbers where {count} are declared")
    record = [(name, "f8", (width,) if width > 1 else ()) for name, width in zip(kind.names or (), widths)]
    return np.ascontiguousarray(values).view(np.dtype(record)).reshape(-1)


def _unpacked(path: Path, at: int, count: int, kind: np.dtype[Any]) -> dict[str, NDArray[Any]] | Any:
    """Decompress a file, and return its points as records."""
    from touchfield.sources.clouds.kernels.lzf import decompress

    with path.open("rb") as file:
        file.seek(at)
        sizes = np.frombuffer(file.read(8), "<u4")
        if len(sizes) < 2:
            raise ValueError("no sizes of the compressed data")
        packed_size, size = (int(value) for value in sizes)
        if size != count * kind.itemsize:
            raise ValueError(f"{size} bytes where its {count} points take {count * kind.itemsize}")
        packed = np.frombuffer(file.read(min(packed_size, path.stat().st_size)), np.uint8)
    _require(len(packed), packed_size, count)
    if size > _MAX_RATIO * packed_size:
        raise ValueError(f"{packed_size} bytes for {size}, which no compression reaches")
    data = decompress(packed, size)
    rows, first = np.empty(count, kind), 0
    for name in kind.names or ():
        length = count * kind[name].itemsize
        values = np.frombuffer(data, kind[name].base, length // kind[name].base.itemsize, first)
        rows[name] = values.reshape(rows[name].shape)
        first += length
    return rows
