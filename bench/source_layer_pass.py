"""Counts the corrections that a frame needs beyond a given base layer: the voxel pass of coder `touch`, which
``source_layer.c`` compiles with any vectors as its reference.

The payload is decoded again by the reader of ``c/touch.h``, with the same reference.
"""

from __future__ import annotations

import ctypes
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rate_symbols import F0_N, K
from touchfield.medium import ForceField

ROOT = Path(__file__).resolve().parents[1]


class _Cost(ctypes.Structure):
    _fields_ = (
        ("payload_bytes", ctypes.c_uint64),
        ("outliers", ctypes.c_uint64),
        ("outlier_bytes", ctypes.c_uint64),
        ("within", ctypes.c_uint64),
        ("violations", ctypes.c_uint64),
        ("max_error_ratio", ctypes.c_double),
        ("is_decoded", ctypes.c_int32),
    )


class Corrections(NamedTuple):
    """The cost of a frame beyond its base layer.

    bytes : of the payload and of outliers (17 bytes each, an upper limit).
    within_fraction : of the voxels with a force in either field, those at which the base layer is within the
        bound.
    max_error_ratio : largest error of the decoded frame without outliers, of the bound.
    outliers : voxels that are sent exactly.
    """

    bytes: int
    within_fraction: float
    max_error_ratio: float
    outliers: int


@cache
def library() -> ctypes.CDLL:
    """Return ``source_layer.c``, compiled as the package's module is."""
    sys.path.insert(0, str(ROOT / "build_backend"))
    import compiler  # type: ignore[import-not-found]

    path = Path(tempfile.mkdtemp()) / "source_layer.so"
    command = [*compiler.find_compiler(), *compiler.OPTIONS, f"-I{ROOT / 'c'}", "-w", "-o", str(path)]
    subprocess.run([*command, str(ROOT / "bench" / "source_layer.c"), "-lm"], check=True)
    return ctypes.CDLL(str(path))


def corrections(
    frame: ForceField, bricks: NDArray[np.int32], vectors: NDArray[np.int32], k: float = K, f0_n: float = F0_N
) -> Corrections:
    """Return the cost of a frame with a base layer, of which `bricks` are int32 [n, 3], ascending.

    `vectors` are int32 [n, 512, 3], in units of the longest force of the frame over 65536. Raises RuntimeError
    if the pass fails, or the reader decodes other vectors than the writer.
    """
    own = np.ascontiguousarray(frame.bricks, np.int32), np.ascontiguousarray(frame.forces_n, np.float32)
    layer = np.ascontiguousarray(bricks, np.int32), np.ascontiguousarray(vectors, np.int32)
    shape, spacing = (ctypes.c_uint32 * 3)(*frame.grid.shape), (ctypes.c_double * 3)(*frame.grid.spacing_m)
    cost = _Cost()
    counts = [ctypes.c_uint64(len(own[0])), ctypes.c_uint64(len(layer[0]))]
    pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (*own, *layer)]
    bound = ctypes.c_double(k), ctypes.c_double(f0_n)
    code = library().layer_cost_of(
        shape, spacing, *bound, counts[0], *pointers[:2], counts[1], *pointers[2:], ctypes.byref(cost)
    )
    if code or not cost.is_decoded:
        raise RuntimeError(f"the voxel pass ended with code {code}, decoded alike: {bool(cost.is_decoded)}")
    return Corrections(
        cost.payload_bytes + cost.outlier_bytes,
        cost.within / max(cost.within + cost.violations, 1),
        cost.max_error_ratio,
        cost.outliers,
    )
