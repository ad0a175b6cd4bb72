"""Weighted sums of four short rows at once, their sums held in registers: the inner loop of sparse filters.

A loop of 24 numbers is too short for the compiler: the tests that two rows do not overlap, and sums put down and
taken up again, cost as much as the sums. Here the vectors are written as such; which instructions they become is
still the compiler's affair. They have eight lanes: those of 24 it would take to pieces after the loop. Imported only
when first needed, because it imports numba.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

__all__ = ["ROW", "four_rows"]

ROW = 24
"""Numbers of a brick's row: eight samples of three components."""

_LANES = 8  # twelve sums of them leave registers for a weight
_FLOATS = ir.VectorType(ir.FloatType(), _LANES)
_SAME_PLACE = ir.Constant(ir.VectorType(ir.IntType(32), _LANES), [0] * _LANES)


def _four_rows(
    typing: Any,
    out: Any,
    o: Any,
    out_step: Any,
    flat: Any,
    at: Any,
    step: Any,
    offsets: Any,
    weights: Any,
    count: Any,
) -> Any:
    """``out[o + r out_step + n] = sum over k of weights[k] flat[at + r step + offsets[k] + n]``, r < 4, n < 24.

    The sum runs over the first `count` of `offsets` int64 and `weights` float32; of none it is zero. `out` and `flat`
    are float32 [n]. Product and addition may be rounded once. No place is tested.
    """
    signature = types.void(
        out, types.int64, types.int64, flat, types.int64, types.int64, offsets, weights, types.int64
    )

    def generated(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        def data(kind: Any, value: Any) -> Any:
            return context.make_array(kind)(context, builder, value).data

        def part(numbers: Any, first: Any, stride: Any, n: int) -> Any:
            row, lane = divmod(n * _LANES, ROW)
            place = builder.add(first, builder.mul(stride, ir.Constant(ir.IntType(64), row)))
            place = builder.add(place, ir.Constant(ir.IntType(64), lane))
            return builder.bitcast(builder.gep(numbers, [place]), _FLOATS.as_pointer())

        o, out_step, at, step = (arguments[n] for n in (1, 2, 4, 5))
        target, source = data(signature.args[0], arguments[0]), data(signature.args[3], arguments[3])
        offsets, weights = data(signature.args[6], arguments[6]), data(signature.args[7], arguments[7])
        nothing = ir.Constant(_FLOATS, [0.0] * _LANES)
        sums = [cgutils.alloca_once_value(builder, nothing) for _ in range(4 * ROW // _LANES)]
        for kept in sums:
            builder.store(nothing, kept)
        with cgutils.for_range(builder, arguments[8]) as loop:
            weight = builder.load(builder.gep(weights, [loop.index]))
            spread = builder.insert_element(
                ir.Constant(_FLOATS, ir.Undefined), weight, ir.Constant(ir.IntType(32), 0)
            )
            spread = builder.shuffle_vector(spread, ir.Constant(_FLOATS, ir.Undefined), _SAME_PLACE)
            first = builder.add(at, builder.load(builder.gep(offsets, [loop.index])))
            for n, kept in enumerate(sums):
                numbers = builder.load(part(source, first, step, n), align=4)
                product = builder.fmul(spread, numbers, flags=("contract",))
                builder.store(builder.fadd(builder.load(kept), product, flags=("contract",)), kept)
        for n, kept in enumerate(sums):
            builder.store(builder.load(kept), part(target, o, out_step, n), align=4)
        return context.get_dummy_value()

    return signature, generated


four_rows: Any = intrinsic(_four_rows)
