"""Counts the corrections that frames need beyond given base layers: the voxel pass of coder `touch`, which
``source_layer.c`` compiles with any vectors as its reference.

Each payload is decoded again by the reader of ``c/touch.h``, with the same reference.
"""

from __future__ import annotations

import ctypes
import subprocess
import sys
import tempfile
from collections.abc import Sequence
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
        ("payload_bytes", ctypes.c_uint64 * 2),
        ("outlier_bytes", ctypes.c_uint64 * 2),
        ("within", ctypes.c_uint64),
        ("violations", ctypes.c_uint64),
        ("max_error_ratio", ctypes.c_double),
        ("is_decoded", ctypes.c_int32),
        ("has_layer", ctypes.c_int32),
    )


class Layer(NamedTuple):
    """A coded base layer of a frame.

    bytes : its size.
    bricks : int32 [n, 3], ascending.
    vectors : int32 [n, 512, 3], in units of the longest force of the segment over 65536.
    """

    bytes: int
    bricks: NDArray[np.int32]
    vectors: NDArray[np.int32]


class FrameCost(NamedTuple):
    """The cost of a frame.

    layer_bytes : of its base layer.
    corrections : bytes of the payload and of outliers (17 each, an upper limit) with the base layer.
    other : the same with the frame before, or nothing, as the reference.
    within_fraction : of the voxels with a force in either field, those at which the base layer is within the
        bound.
    max_error_ratio : largest error before outliers, of the bound, of the way that takes fewer bytes.
    has_layer : whether that is the one with the base layer.
    """

    layer_bytes: int
    corrections: int
    other: int
    within_fraction: float
    max_error_ratio: float
    has_layer: bool

    @property
    def bytes(self) -> int:
        """Bytes of the better way."""
        return self.layer_bytes + self.corrections if self.has_layer else self.other


@cache
def library() -> ctypes.CDLL:
    """Return ``source_layer.c``, compiled as the package's module is."""
    sys.path.insert(0, str(ROOT / "build_backend"))
    import compiler  # type: ignore[import-not-found]

    path = Path(tempfile.mkdtemp()) / "source_layer.so"
    command = [*compiler.find_compiler(), *compiler.OPTIONS, f"-I{ROOT / 'c'}", "-w", "-o", str(path)]
    subprocess.run([*command, str(ROOT / "bench" / "source_layer.c"), "-lm"], check=True)
    return ctypes.CDLL(str(path))


def unit_n(frames: Sequence[ForceField]) -> float:
    """Return the unit of a segment of frames, newtons, as the encoder rounds it."""
    squares = [np.square(f.forces_n.astype(np.float64)).sum(axis=-1).max(initial=0.0) for f in frames]
    return float(np.float32(np.sqrt(max(squares)) / 65536))


def frame_costs(
    frames: Sequence[ForceField], layers: Sequence[Layer], k: float = K, f0_n: float = F0_N
) -> list[FrameCost]:
    """Return the cost of each frame of a segment.

    Raises RuntimeError if the pass fails, or the reader decodes other vectors than the writer.
    """
    grid, costs = frames[0].grid, (_Cost * len(frames))()
    arrays = list[NDArray[np.generic]]()
    for frame, layer in zip(frames, layers, strict=True):
        arrays += [frame.bricks.astype(np.int32), frame.forces_n.astype(np.float32)]
        arrays += [layer.bricks.astype(np.int32), layer.vectors.astype(np.int32)]
    arrays = [np.ascontiguousarray(array) for array in arrays]
    counts = [len(array) for array in arrays[::2]]
    code = library().layer_costs(
        (ctypes.c_uint32 * 3)(*grid.shape),
        (ctypes.c_double * 3)(*grid.spacing_m),
        ctypes.c_double(k),
        ctypes.c_double(f0_n),
        ctypes.c_uint32(len(frames)),
        (ctypes.c_uint64 * len(counts))(*counts),
        (ctypes.c_void_p * len(arrays))(*(array.ctypes.data for array in arrays)),
        (ctypes.c_uint64 * len(layers))(*(layer.bytes for layer in layers)),
        costs,
    )
    if code or not all(cost.is_decoded for cost in costs):
        raise RuntimeError(f"the voxel pass ended with code {code}, or a reader decodes other vectors")
    return [
        FrameCost(
            layer.bytes,
            cost.payload_bytes[0] + cost.outlier_bytes[0],
            cost.payload_bytes[1] + cost.outlier_bytes[1],
            cost.within / max(cost.within + cost.violations, 1),
            cost.max_error_ratio,
            bool(cost.has_layer),
        )
        for cost, layer in zip(costs, layers)
    ]
