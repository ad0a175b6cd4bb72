"""The light frame model of coder `touch`: effort `default`.

One pass from deep to shallow codes support, amplitude and direction together, in closed loop, each sample expected
from its neighbours by linear weights that travel in the frame; paper section 5.2, whose a and D these are.

The bytes of a frame: the length of the list of bricks, varint, and that list (`codec.support`, all bricks full);
nothing more if it is empty. Then a byte: which axis is slowest (0 to 2), and 4, 8, 16 where the slowest, the middle
or the fastest axis is walked downwards; the slopes along the three axes of the scan, zigzag varints; a byte: 64 times
the way of the frame (`light_plan.Plan.usual`) and the mix; two bytes, bit n set where class n has weights of its own,
and these, 13 signed bytes each; then the arithmetic code to the end, of whose last six bytes trailing zeros are left
away.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.codec.touch.fixed_field import FixedField
from touchfield.codec.touch.frame_model import CodedFrame
from touchfield.codec.touch.light_plan import MOST, course_of, plan_of
from touchfield.codec.touch.light_scan import Scan, read_slopes, scan_of, turn_of, write_slopes
from touchfield.codec.touch.old_brick_list import read_bricks, write_bricks
from touchfield.codec.touch.warp import tables_of
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium.grid import BRICK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.touch.frame_model import Known, Rule
    from touchfield.codec.touch.lattice import Lattice
    from touchfield.codec.touch.light_plan import Plan
    from touchfield.medium import ForceField

    Int64s = NDArray[np.int64]

__all__ = ["LightModel"]

_WHERE: Final = "frame of coder touch"
_FEW: Final = 20
"""Samples of a class below which it goes without weights of its own."""

_NOISE: Final = 0.2
"""What coding adds to the variance of a feature, in squared steps."""

_NOISE_CLOSED: Final = 0.02
"""The same where the features were coded already."""

_FITTED: Final = 12000
"""Samples that weights are fitted to, about."""

_FEW_VOXELS: Final = 50000
"""Up to here there is the time to fit weights twice."""

_THRIFT: Final = 0.1
"""What a bit may cost in mode nmse, squared steps."""

_THRIFT_GUESSED: Final = 0.5
"""The same beside a guess, of which what lies off costs many bits."""


class LightModel:
    """Frame model 1; see `FrameModel`."""

    number: int = 1

    def encode(self, frame: ForceField, known: Known, rule: Rule) -> CodedFrame:
        """Code one frame; see `FrameModel`."""
        from touchfield.codec.kernels import touch_light_chain as chain
        from touchfield.codec.kernels import touch_light_choice as choice

        lattice = known.lattice
        scale = 1.0 / np.float64(np.float32(lattice.unit_n))
        f0 = lattice.floor * 0.5 if rule.free else rule.f0_n * scale
        thrift = _THRIFT if known.guess is None else _THRIFT_GUESSED
        numbers = np.array([rule.k, f0, rule.sine, thrift, rule.free, rule.movable], np.float64)
        bricks, forces = np.array(frame.bricks), frame.forces_n
        if rule.movable and len(bricks):
            peak = np.abs(forces).reshape(len(bricks), -1).max(axis=1) * scale > f0 / 2
            if not peak.all():
                bricks, forces = bricks[peak], forces[peak]
        forces = np.array(forces, np.float32)
        head = write_bricks(frame.grid, bricks, known.previous)
        if len(bricks) == 0:
            decoded = FixedField(bricks, np.zeros((0, BRICK, BRICK, BRICK, 3), np.int32))
            return CodedFrame(head, decoded, (8.0 * len(head), 0.0, 0.0), np.zeros(0, np.int64))
        turn, slope, way = course_of(forces, scale, frame.grid)
        head += bytes([way]) + write_slopes(slope)
        scan, reference = scan_of(known, bricks, way)
        flat = forces.reshape(-1, 3)
        voxels = int(np.count_nonzero(flat.any(axis=1)))
        law = self._law(slope, turn, lattice)
        breaks = chain.chain_breaks(
            flat, scale, numbers, scan.where, scan.stride, law, lattice.floor, lattice.rate, reference,
            scan.reference_slot,
        )  # fmt: skip
        common = flat, scale, numbers
        ways = [False, True] if rule.free else [True]
        tried = []
        for chains in ways:  # where every error has its price, to inherit one is a gain in clean fields alone
            plan = plan_of(
                breaks, scan.reference_slot, voxels, chains=chains, most=MOST, guessed=known.guess is not None
            )
            tried.append(self._coded(plan, common, scan, reference, law, lattice, voxels))
        if len(tried) > 1:
            tried.sort(key=lambda one: _worth(flat * scale, one, lattice, thrift))
        tell, data, out, prices = tried[0]
        head += tell
        decoded = FixedField(bricks, out.reshape(-1, BRICK, BRICK, BRICK, 3))
        misses = np.flatnonzero(choice.missed(flat, out, scale, numbers))
        prices *= 8.0 * len(data) / max(prices.sum(), 1.0)
        prices[0] += 8.0 * len(head)
        support, amplitude, direction = prices.tolist()
        return CodedFrame(head + data, decoded, (support, amplitude, direction), misses)

    def _law(self, slope: Int64s, turn: Int64s, lattice: Lattice, usual: int = 0, mix: int = 0) -> Int64s:
        least = max(1, lattice.floor >> 1)
        return np.array([*slope, *turn, least, usual, mix, 0, lattice.floor, lattice.rate], np.int64)

    def _coded(
        self, plan: Plan, common: tuple[Any, ...], scan: Scan, reference: NDArray[np.int32], law: Int64s,
        lattice: Lattice, voxels: int,
    ) -> tuple[bytes, bytes, NDArray[np.int32], NDArray[np.float64]]:  # fmt: skip
        """How it is predicted, the code, the decoded vectors by slots, and the bits of each kind."""
        from touchfield.codec.kernels import touch_light as kernels
        from touchfield.codec.kernels import touch_light_coder as coder

        law = law.copy()
        law[kernels.USUAL], law[kernels.MIX] = plan.usual, plan.mix
        sampled = 1 + voxels // _FITTED
        shape = (len(common[0]), 3)

        def run(task: int, weights: Int64s, gather: int) -> tuple[bytes, NDArray[np.int32], Any, Any]:
            room = len(common[0]) + (1 << 16)
            while True:
                state, buffer = coder.start(None), np.empty(room, np.uint8)
                taken, prices, equations = np.zeros(shape, np.int32), np.zeros(3), np.zeros(kernels.SUMS)
                end = self._run(
                    task, gather, common, taken, reference, scan, weights, law, plan.ways, lattice, state, buffer,
                    equations, prices,
                )  # fmt: skip
                if end != kernels.FULL:
                    data = b"" if task == kernels.FIT else _weight_bytes(weights) + coder.stop(state, buffer)
                    return data, taken, equations, prices
                room *= 4

        weights = np.zeros((kernels.CLASSES, kernels.FEATURES), np.int64)
        weights = _solve(run(kernels.FIT, weights, sampled)[2])
        again = voxels <= _FEW_VOXELS
        data, out, equations, prices = run(kernels.ENCODE, weights, sampled if again else 0)
        if again:  # with what the closed loop taught
            more, other, _, spent = run(kernels.ENCODE, _solve(equations, _NOISE_CLOSED), 0)
            if len(more) < len(data):
                data, out, prices = more, other, spent
        return bytes([plan.usual << 6 | plan.mix]), data, out, prices

    def decode(self, payload: bytes, known: Known) -> FixedField:
        """The inverse; see `FrameModel`.

        Raises
        ------
        CorruptFile, TruncatedFile
            If the bytes are not what `encode` writes.
        """
        from touchfield.codec.kernels import touch_light as kernels
        from touchfield.codec.kernels import touch_light_coder as coder

        bricks, at = read_bricks(payload, 0, known.grid, _WHERE, known.previous)
        out = np.zeros((len(bricks) * BRICK**3, 3), np.int32)
        if len(bricks) == 0:
            if len(payload) > at:
                raise CorruptFile(_WHERE, f"{len(payload) - at} bytes behind an empty frame", "none")
            return FixedField(bricks, out.reshape(-1, BRICK, BRICK, BRICK, 3))
        if at >= len(payload):
            raise TruncatedFile(_WHERE, f"the end of the bytes at offset {at}", "the direction of the scan")
        way = payload[at]
        if way & 3 == 3 or way > 31:
            raise CorruptFile(_WHERE, f"direction of the scan {way}", "an axis 0 to 2 and three bits")
        slope, at = read_slopes(payload, at + 1, _WHERE)
        if at >= len(payload):
            raise TruncatedFile(_WHERE, f"the end of the bytes at offset {at}", "how it is predicted")
        usual, mix, at = payload[at] >> 6, payload[at] & 63, at + 1
        if usual == 0 and mix > 0:
            raise CorruptFile(_WHERE, f"a mix of {mix} with nothing to follow", "0")
        law = self._law(slope, turn_of(way & 3), known.lattice, usual, mix)
        weights, at = _read_weights(payload, at)
        scan, reference = scan_of(known, bricks, way)
        data = np.frombuffer(payload, np.uint8, offset=at).copy()
        state = coder.start(data)
        common = (np.zeros((1, 3), np.float32), 1.0, np.zeros(6))
        nothing = np.zeros((1, 1, 1))
        status = self._run(
            kernels.DECODE, 0, common, out, reference, scan, weights, law, np.zeros(len(bricks), np.int64),
            known.lattice, state, data, nothing, np.zeros(3),
        )  # fmt: skip
        place = int(state[coder.PLACE])
        if status == kernels.ENDED or place > len(data) + 6:
            raise TruncatedFile(_WHERE, f"the end of the code after {len(payload)} bytes", f"{len(bricks)} bricks")
        if len(data) > place:
            raise CorruptFile(_WHERE, f"{len(data) - place} bytes behind the end of the code", "none")
        return FixedField(bricks, out.reshape(-1, BRICK, BRICK, BRICK, 3))

    def _run(
        self, task: int, sampled: int, common: tuple[Any, ...], out: NDArray[np.int32], reference: NDArray[np.int32],
        scan: Scan, weights: Int64s, law: Int64s, ways: Int64s, lattice: Lattice, state: Int64s,
        buffer: NDArray[np.uint8], sums: NDArray[np.float64], prices: NDArray[np.float64],
    ) -> int:  # fmt: skip
        from touchfield.codec.kernels import touch_light as kernels
        from touchfield.codec.kernels import touch_light_coder as coder

        chances = np.full(kernels.CHANCES, coder.FRESH, np.uint32)
        mixes = np.full((kernels.MIXES, 3), 26214, np.int64)
        law = law.copy()
        law[kernels.FITTED] = weights.any() or task == kernels.FIT
        status = kernels.code_frame(
            task, sampled, *common, out, reference, scan.reference_slot, scan.where, scan.tiles,
            scan.low, scan.high, scan.layers, scan.layer_at, scan.stride, scan.width, law, weights.reshape(-1),
            ways.copy(), *tables_of(lattice), state, buffer, chances, mixes, sums, prices,
            *kernels.workspace(scan.width),
        )  # fmt: skip
        return int(status)


def _worth(
    units: NDArray[np.float64], coded: tuple[bytes, bytes, NDArray[np.int32], Any], lattice: Lattice, thrift: float
) -> float:
    """What a code costs in mode nmse, squared steps."""
    error = float(((coded[2] - units) ** 2).sum()) / lattice.floor**2
    return error + thrift * 8 * len(coded[1])


# -- numbers that travel in the frame ---------------------------------------------------------------------


def _solve(sums: NDArray[np.float64], noise: float = _NOISE) -> Int64s:
    """Weights of each class by least squares, 1/64, int64 [16, 13]."""
    features = sums.shape[1] - 1
    out = np.zeros((len(sums), features), np.int64)
    for kind, equations in enumerate(sums):
        if equations[features, features] < _FEW:
            continue
        square = np.tril(equations[:features, :features])
        square = square + np.tril(square, -1).T
        square[np.diag_indices(features)] += 1.0 + noise * equations[:features, features]
        out[kind] = np.clip(np.rint(64 * np.linalg.solve(square, equations[features, :features])), -128, 127)
    return out


def _weight_bytes(weights: Int64s) -> bytes:
    own = weights.any(axis=1)
    flags = sum(1 << n for n in np.flatnonzero(own).tolist())
    return flags.to_bytes(2, "little") + weights[own].astype(np.int8).tobytes()


def _read_weights(payload: bytes, at: int) -> tuple[Int64s, int]:
    from touchfield.codec.kernels import touch_light as kernels

    flags = int.from_bytes(payload[at : at + 2], "little")
    end = at + 2 + flags.bit_count() * kernels.FEATURES
    if len(payload) < end:
        raise TruncatedFile(_WHERE, f"the end of the bytes at offset {len(payload)}", f"weights up to {end}")
    out = np.zeros((kernels.CLASSES, kernels.FEATURES), np.int64)
    own = [n for n in range(kernels.CLASSES) if flags >> n & 1]
    out[own] = np.frombuffer(payload, np.int8, end - at - 2, at + 2).reshape(-1, kernels.FEATURES)
    return out, end
