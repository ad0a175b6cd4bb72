"""The chapters of docs/format.md on coder `touch`, put together; the frame models and guesses have modules of theirs.

Only the writer of the document imports this module. conformance/reference_touch.py follows these pages.
"""

from __future__ import annotations

from typing import Final

from touchfield.codec.kernels.touch_lattice import LIMIT
from touchfield.codec.touch import body, exceptions, parameters
from touchfield.codec.touch.light_format import LIGHT_CHAPTER
from touchfield.codec.touch.lossless_format import LOSSLESS_CHAPTER
from touchfield.codec.touch.max_format import MAX_CHAPTER
from touchfield.codec.touch.motion_format import MOTION_CHAPTER
from touchfield.codec.touch.post_filter_format import POST_FILTER_CHAPTER
from touchfield.codec.touch.quick_format import QUICK_CHAPTER
from touchfield.codec.touch.surface_format import SURFACE_CHAPTER

__all__ = ["CHAPTER", "CHAPTERS"]

BODY: Final = f"""\
## The body of a segment: coder `touch`

{parameters.CHAPTER}
k is 0.001 to below 1, F_0 0 or more, the direction JND above 0 and below 90, the step above 0. Decoding needs no more
of them than whether the mode is 3; the others tell what was promised. Varints and chunks are those of coder `paper`,
and so are bricks, their order and the code of a support.

{body.CHAPTER}
The parts fill the body exactly.

### Fields in units

All of decoding is in whole numbers; `>>` and `//` round down, for negative numbers too, and no number, of whatever
intermediate step, reaches 2^53 in size. A decoded frame is a list of bricks, ascending, and a vector of three whole
numbers of units, each within ±{LIMIT}, for each of their samples; a brick may hold no force at all, and is in the
list all the same. A sample *has a force* if its vector is not (0, 0, 0). The force in newtons is the vector times the
unit, a float32 product for each component; whether a zero is +0 or -0 has no meaning, but in mode lossless.

The *previous frame* of a frame is the one before it in the segment in units, as decoded from its payload, without its
filter and exceptions. A frame model knows it only if bit 3 says so; guess 1 is made of it in any case.

{exceptions.CHAPTER}
An exception is a sample of the grid. A force of zero is (0, 0, 0).

### The lattice

A force of a units has the step max(floor, (a rate) >> 16) along it, and max(cross floor, (a cross rate) >> 16) across
it. A *level* counts steps from 0, in 1/256. The borders b(n), in 1/256 units, lie a sixteenth of a step apart:

```text
b(0) = 0;   b(n+1) = b(n) + max(1, max(256 floor, (b(n) rate) >> 16) >> 4),   up to the first above 2^26, b(N)
level(a)      = 16 n + (16 (256 a - b(n))) // (b(n+1) - b(n)),   b(n) <= 256 a < b(n+1),   0 <= a < 2^18
amplitude(l)  = (b(n) + (((b(n+1) - b(n)) m) >> 4) + 128) >> 8,   16 n + m = min(|l|, 16 N - 1), 0 <= m < 16;
                its negative for l < 0
```

root(n) is the square root, rounded down. The *axes along* a vector p of length a >= 1 are e, h, k in 1/16384:

```text
short(v, n) = (v_c (2^44 // n) + 2^29) >> 30, for each component c
e = short(p, a)
g = |e_z| < 14746 ? (-e_y, e_x, 0) : (0, -e_z, e_y)
h = short(g, max(1, root(g · g)))
k = ((e_y h_z - e_z h_y) >> 14, (e_z h_x - e_x h_z) >> 14, (e_x h_y - e_y h_x) >> 14)
rebuilt(A, s, t) = (A e + s h + t k + 8192) >> 14, each component within ±{LIMIT}
```
"""

CHAPTERS: Final = (
    BODY,
    MOTION_CHAPTER,
    SURFACE_CHAPTER,
    LIGHT_CHAPTER,
    QUICK_CHAPTER,
    MAX_CHAPTER,
    POST_FILTER_CHAPTER,
    LOSSLESS_CHAPTER,
)

CHAPTER: Final = "\n".join(CHAPTERS)
"""What `touchfield.container.format_document` prints on coder `touch`."""
