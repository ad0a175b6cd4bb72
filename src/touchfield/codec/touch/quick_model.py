"""The quick frame model of coder `touch`: effort `fast`, 100 frames a second of a field of 128^3 on two cores.

One pass from deep to shallow codes support, amplitude and direction together, in closed loop, each sample expected
from one neighbour by the law of the field; paper section 5.2, whose a and D these are. What the light model has
beyond this was left away for time: mixed chances, and weights for a blend of neighbours. `quick_format` tells the
bytes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.codec.touch.fixed_field import FixedField
from touchfield.codec.touch.frame_model import CodedFrame
from touchfield.codec.touch.light_plan import course_of, plan_of
from touchfield.codec.touch.light_scan import Scan, read_slopes, scan_of, turn_of, write_slopes
from touchfield.codec.touch.old_brick_list import read_bricks, write_bricks
from touchfield.codec.touch.warp import tables_of
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium.grid import BRICK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.touch.frame_model import Known, Rule
    from touchfield.codec.touch.lattice import Lattice
    from touchfield.medium import ForceField

    Int64s = NDArray[np.int64]

__all__ = ["QuickModel"]

_WHERE: Final = "frame of coder touch"


class QuickModel:
    """Frame model 0; see `FrameModel`."""

    number: int = 0

    def encode(self, frame: ForceField, known: Known, rule: Rule) -> CodedFrame:
        """Code one frame; see `FrameModel`."""
        from touchfield.codec.kernels import touch_light_chain as chain
        from touchfield.codec.kernels import touch_light_choice as choice
        from touchfield.codec.kernels import touch_light_coder as coder
        from touchfield.codec.kernels import touch_quick as kernels
        from touchfield.codec.kernels import touch_quick_choice as own

        lattice = known.lattice
        scale = 1.0 / np.float64(np.float32(lattice.unit_n))
        f0 = lattice.floor * 0.5 if rule.free else rule.f0_n * scale
        numbers = np.array([rule.k, f0, rule.sine, rule.thrift, rule.free, rule.movable], np.float64)
        bricks, forces = np.array(frame.bricks), np.array(frame.forces_n, np.float32)
        peak, voxels = own.looked_over(forces)
        if rule.movable and len(bricks):
            needed = peak * scale > f0 / 2
            if not needed.all():
                bricks, forces = bricks[needed], forces[needed]
        head = write_bricks(frame.grid, bricks, known.previous)
        out = np.empty((len(bricks) * BRICK**3, 3), np.int32)
        decoded = FixedField(bricks, out.reshape(-1, BRICK, BRICK, BRICK, 3))
        if len(bricks) == 0:
            return CodedFrame(head, decoded, (8.0 * len(head), 0.0, 0.0), np.zeros(0, np.int64))
        turn, slope, way = course_of(forces, scale, frame.grid)
        scan, reference = scan_of(known, bricks, way)
        flat = forces.reshape(-1, 3)
        law = np.array([*slope, *turn, 0, max(1, lattice.floor >> 1)], np.int64)
        breaks = chain.chain_breaks(
            flat, scale, numbers, scan.where, scan.stride, law, lattice.floor, lattice.rate, reference,
            scan.reference_slot, True,
        )  # fmt: skip
        plan = plan_of(breaks, scan.reference_slot, voxels)
        law[kernels.USUAL] = plan.usual
        head += bytes([way | plan.usual << 5])
        head += write_slopes(slope)
        room = len(bricks) * BRICK**3 + (1 << 16)
        while True:
            state, buffer, prices = coder.start(None), np.empty(room, np.uint8), np.zeros(4)
            end = self._run(
                (flat, scale, numbers), out, reference, scan, law, plan.ways, lattice, state, buffer, prices
            )
            if end != kernels.FULL:
                break
            room *= 4
        data = coder.stop(state, buffer)
        misses = np.zeros(0, np.int64)
        if prices[3] > 0:
            misses = np.flatnonzero(choice.missed(flat, out, scale, numbers))
        prices = prices[:3] * 8.0 * len(data) / max(prices[:3].sum(), 1.0)
        prices[0] += 8.0 * len(head)
        support, amplitude, direction = prices.tolist()
        return CodedFrame(head + data, decoded, (support, amplitude, direction), misses)

    def decode(self, payload: bytes, known: Known) -> FixedField:
        """The inverse; see `FrameModel`.

        Raises
        ------
        CorruptFile, TruncatedFile
            If the bytes are not what `encode` writes.
        """
        from touchfield.codec.kernels import touch_light_coder as coder
        from touchfield.codec.kernels import touch_quick as kernels
        from touchfield.codec.kernels.touch_quick_coder import ROOM

        bricks, at = read_bricks(payload, 0, known.grid, _WHERE, known.previous)
        out = np.empty((len(bricks) * BRICK**3, 3), np.int32)
        made = FixedField(bricks, out.reshape(-1, BRICK, BRICK, BRICK, 3))
        if len(bricks) == 0:
            if len(payload) > at:
                raise CorruptFile(_WHERE, f"{len(payload) - at} bytes behind an empty frame", "none")
            return made
        if at >= len(payload):
            raise TruncatedFile(_WHERE, f"the end of the bytes at offset {at}", "the direction of the scan")
        way, usual = payload[at] & 31, payload[at] >> 5
        if way & 3 == 3 or not 1 <= usual <= 3:
            raise CorruptFile(_WHERE, f"direction of the scan {payload[at]}", "an axis 0 to 2 and a way 1 to 3")
        slope, at = read_slopes(payload, at + 1, _WHERE)
        least = max(1, known.lattice.floor >> 1)
        law = np.array([*slope, *turn_of(way & 3), usual, least], np.int64)
        scan, reference = scan_of(known, bricks, way)
        code = np.frombuffer(payload, np.uint8, offset=at)
        state = coder.start(code)
        data = np.zeros(len(code) + ROOM, np.uint8)
        data[: len(code)] = code
        status = self._run(
            (None, 1.0, np.zeros(6)), out, reference, scan, law, np.zeros(len(bricks), np.int64), known.lattice,
            state, data, np.zeros(4),
        )  # fmt: skip
        place = int(state[coder.PLACE])
        if status == kernels.ENDED or place > len(code) + 6:
            raise TruncatedFile(_WHERE, f"the end of the code after {len(payload)} bytes", f"{len(bricks)} bricks")
        if len(code) > place:
            raise CorruptFile(_WHERE, f"{len(code) - place} bytes behind the end of the code", "none")
        return made

    def _run(
        self, common: tuple[Any, ...], out: NDArray[np.int32], reference: NDArray[np.int32], scan: Scan, law: Int64s,
        ways: Int64s, lattice: Lattice, state: Int64s, data: NDArray[np.uint8], prices: NDArray[np.float64],
    ) -> int:  # fmt: skip
        from touchfield.codec.kernels import touch_light_coder as coder
        from touchfield.codec.kernels import touch_quick as kernels

        status = kernels.code_frame(
            *common, out, reference, scan.reference_slot, scan.where, scan.tiles, scan.low, scan.high, scan.layers,
            scan.layer_at, scan.stride, scan.width, law, ways.copy(), *tables_of(lattice), state, data,
            np.full(kernels.CHANCES, coder.FRESH, np.uint32), prices,
            *kernels.workspace(scan.width, int(np.diff(scan.layers).max()), common[0] is not None),
        )  # fmt: skip
        return int(status)
