"""Encoding of a frame of the coder `touch`: limits, scan order, mode decision.

A frame is coded with or without the frame before, and with or without a base layer. The mode with the fewest
bytes is chosen; in mode "nmse" that with the least cost of bytes and errors. A cell of the lattice with three
equal edges s has the half diagonal s sqrt(3) / 2: it lies within the ball of the mask if s <= 2 / sqrt(3)
max(F_0, k |F|). Steps along and across the force differ in mode "mask-direction", whose mask is a disc of
directions times a span of lengths.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Float32s
from touchfield.codec.kernels import finish, writer
from touchfield.codec.support import code_bricks, pad_payload
from touchfield.codec.touch.base_layer_fit import fit_base_layer
from touchfield.codec.touch.error_bound import fraction_within_bound
from touchfield.codec.touch.frame import Memory, ScanOrder, new_memory, step_table
from touchfield.codec.touch.kernels.decode_pass import CONTEXTS, SETS
from touchfield.codec.touch.kernels.encode_pass import ROOM, Limits, encode_bricks
from touchfield.codec.touch.kernels.workspace import fresh_work
from touchfield.codec.touch.lattice import (
    FLOOR_LIMIT,
    MIN_FLOOR,
    RATE_LIMIT,
    SMALLEST_UNIT_N,
    TOP,
    FixedField,
    Lattice,
)
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField, Grid

_CELL: Final = 1.17
"""Edge of a cell over max(F_0, k |F|).

A cell with 2 / sqrt(3) = 1.1547 fits the ball exactly. Of a slightly larger cell only the corners are outside
the ball, and the encoder then chooses another point; from 1.25 on there are too many outliers.
"""

# edge along the force over k |F| in mode "mask-direction"; the span of lengths alone would allow 2; measured
_SPAN: Final = 1.8
_SPAN_FLOOR: Final = 1.25  # edge along the force over F_0, where the mask is a ball again (short forces)
# edge of a square cell over the radius of the disc that contains it, with a margin for rounding
_DISC: Final = 0.97 * math.sqrt(2)
# mode "nmse", both measured: largest error in steps, and the price of a bit in squared steps
_BALL: Final = 0.75
_BIT_PRICE: Final = 0.1
_ROUNDING: Final = 2e-6  # relative rounding error of a force


def lattice_for(spec: TouchSpec, longest_n: float) -> Lattice:
    """Lattice of a segment whose longest force is `longest_n`.

    A uniform step is at least 1/3120 of that force.
    """
    unit_n = float(np.float32(max(longest_n / TOP, SMALLEST_UNIT_N)))
    if spec.mode == "nmse":
        step = max(_below(FLOOR_LIMIT, spec.step_n / unit_n), MIN_FLOOR)
        return Lattice(unit_n, step, 0, step, 0)
    floor, rate = _below(FLOOR_LIMIT, _CELL * spec.f0_n / unit_n), _below(RATE_LIMIT, 65536 * _CELL * spec.k)
    if spec.mode == "mask":
        return Lattice(unit_n, floor, rate, floor, rate)
    cross_rate = _below(RATE_LIMIT, 65536 * _DISC * math.sin(math.radians(spec.direction_jnd_deg)))
    span = _below(FLOOR_LIMIT, _SPAN_FLOOR * spec.f0_n / unit_n), _below(RATE_LIMIT, 65536 * _SPAN * spec.k)
    return Lattice(unit_n, *span, floor, cross_rate)


def limits_for(spec: TouchSpec, lattice: Lattice) -> Limits:
    """Error limits of the passes, in units.

    They are reduced by the rounding of whole units to float32 newtons.
    """
    exact = spec.support == "exact"
    if spec.mode == "nmse":
        return Limits(0.0, _BALL * lattice.floor, 0.0, exact)
    margin = 1 - _ROUNDING / spec.k
    sine = math.sin(math.radians(spec.direction_jnd_deg)) if spec.mode == "mask-direction" else 0.0
    return Limits(
        spec.k * margin, spec.f0_n / lattice.unit_n * margin, max(sine - _ROUNDING, sine / 2), exact
    )


def _below(limit: int, number: float) -> int:
    return int(min(max(number, 1), limit - 1))


class CodedFrame(NamedTuple):
    """A coded frame, with the decoder's result and the state after it."""

    payload: bytes
    decoded: FixedField
    bits: tuple[float, float, float]  # of support, amplitude and direction; their sum is the payload's
    memory: Memory
    squared_error: float  # sum of squared errors, units; 0 for frames with an error bound


def _scan_order(vectors: Float32s, grid: Grid) -> ScanOrder:
    """Scan order that follows the force on every axis.

    The slowest axis is that of the largest total force; of two similar ones, that of the coarser spacing.
    """
    flat = vectors.reshape(-1, 3)
    sums, sizes = flat.sum(axis=0, dtype=np.float64), np.abs(flat).sum(axis=0, dtype=np.float64)
    spacing = np.asarray(grid.spacing_m)
    fine = spacing < min(1.01 * spacing.min(), 0.99 * spacing.max())
    axis = int(np.argmax((np.abs(sums) + 0.01 * sizes) * np.where(fine, 0.85, 1.0)))
    return ScanOrder(grid, axis | int((sums[ScanOrder(grid, axis).axes] < 0) @ [4, 8, 16]))


def encode_frame(
    frame: ForceField, lattice: Lattice, reference: FixedField | None, start: Memory, limits: Limits,
    hidden_n: Float32s,
) -> CodedFrame:  # fmt: skip
    """Code a frame, given the inputs of `frame.decode_frame`.

    `hidden_n` is the result of `error_bound.masked_error_n`.
    """
    bricks, scale = frame.bricks, 1.0 / np.float64(np.float32(lattice.unit_n))
    scan_order = _scan_order(frame.forces_n, frame.grid)
    scan_bricks, order = scan_order.order(bricks)
    forces = scan_order.permute(frame.forces_n, order, scale)
    if len(hidden_n):  # permute one number per voxel as a vector of three equal components
        triples = np.repeat(hidden_n.reshape(-1, 8, 8, 8, 1), 3, axis=-1)
        forces = np.concatenate([forces, np.abs(scan_order.permute(triples, order, scale))[..., :1]], axis=-1)
    head = bytes([scan_order.code, 0, 0, 0])  # slopes of 0: no expected loss of force along an axis
    memory, table, prices = start.copy(), step_table(lattice, np.zeros(3, np.int64)), np.zeros(4)
    bits = writer((len(bricks) + 1) * ROOM, memory.models)
    code_bricks(
        bits, CONTEXTS, SETS, frame.grid.brick_shape, bricks, None if reference is None else reference.bricks
    )
    scan = scan_order.scan(scan_bricks, reference)
    encode_bricks(bits, scan, table, fresh_work(memory.weights), forces, limits, prices)
    support, amplitude, direction, _ = prices.tolist()
    return CodedFrame(
        head + pad_payload(finish(bits), len(bricks)),
        FixedField(bricks, scan_order.unpermute(scan.cells, order)),
        (8.0 * len(head) + support, amplitude, direction),
        memory,
        0.0 if limits.k else float(((scan.cells[..., :3] - forces[..., :3]) ** 2).sum()),
    )


# thresholds on fractions of voxels within the bound. Of the frame before as a prediction: a frame is coded as
# an inter frame from _MIN_INTER on, and no base layer is fitted from _NO_BASE_LAYER on. Of a base layer:
# nothing else is tried from _ONLY_BASE_LAYER on.
_MIN_INTER, _NO_BASE_LAYER, _ONLY_BASE_LAYER = 0.1, 0.8, 0.85
_MIN_GAIN: Final = 0.03  # if a base layer saves less than this fraction, the segment fits no further ones

_BaseLayer = tuple[bytes, FixedField]


class ModeDecision:
    """Mode decision of an encoder, with its state within a segment."""

    def __init__(self, grid: Grid, spec: TouchSpec, lattice: Lattice) -> None:
        self._grid, self._spec, self._lattice = grid, spec, lattice
        self._limits: Limits = limits_for(spec, lattice)
        self._previous: FixedField | None = None
        self._memory: Memory = new_memory()
        self._tries_base_layer = spec.guess == "auto"

    def encode(self, frame: ForceField, hidden_n: Float32s) -> tuple[CodedFrame, bool, bytes]:
        """Code the next frame.

        Also returns whether it is an inter frame, and the bytes of its base layer (empty if it has none).
        """
        previous, interframe = self._previous, self._spec.interframe
        inter_fraction = 0.0
        if previous is not None and interframe == "auto":
            inter_fraction = fraction_within_bound(frame, previous, self._lattice.unit_n, self._spec)
        inter = previous is not None and (interframe == "on" or inter_fraction >= _MIN_INTER)
        inter_reference, memory = (previous, self._memory) if inter else (None, new_memory())
        candidates: list[_BaseLayer | None] = [None]
        if self._tries_base_layer and inter_fraction < _NO_BASE_LAYER:
            base_layer, layer_fraction = fit_base_layer(frame, self._lattice, self._limits, self._spec)
            if base_layer is not None and layer_fraction > inter_fraction:
                is_sufficient = layer_fraction >= _ONLY_BASE_LAYER and self._spec.mode != "nmse"
                candidates = [base_layer] if is_sufficient else [base_layer, None]
        results, costs = [], []
        for base_layer in candidates:
            reference = base_layer[1] if base_layer else inter_reference
            coded = encode_frame(frame, self._lattice, reference, memory, self._limits, hidden_n)
            results.append(coded)
            # bytes, and in mode "nmse" the price of the errors
            price = coded.squared_error / self._lattice.floor**2 / (8 * _BIT_PRICE)
            costs.append(price + len(coded.payload) + (len(base_layer[0]) if base_layer else 0))
        if len(results) > 1:
            self._tries_base_layer = costs[0] < (1 - _MIN_GAIN) * costs[1]
        best_index = costs.index(min(costs))
        best, base_layer = results[best_index], candidates[best_index]
        self._previous, self._memory = best.decoded, best.memory
        return best, inter, base_layer[0] if base_layer else b""
