"""What the bytes of block motion are: the chapter of the file format."""

from __future__ import annotations

from typing import Final

__all__ = ["MOTION_CHAPTER"]

MOTION_CHAPTER: Final = """\
### Guess 1: block motion

The bytes: u8 `shape` = 16 * `reach` + `shift`, then one arithmetic code of the blocks that move. `shift` is 2 or
3: blocks have 2^shift samples along each axis, and block (i, j, k) begins at sample 2^shift (i, j, k). `reach` is
0, 1 or 2. The candidates are all blocks within the grid that hold a force in the previous frame, and
those at most `reach` blocks away from one along each axis, in ascending order (x slowest, z fastest).

The decoder, tables, mixed bits and end of the code are those of the support. The first table has 320 contexts, the
second 1104, and there are 16 sets of weights. For each candidate in order: let its neighbours be the candidates one
block before it along z, y and x, in that order, `n` how many of them move, and `held` 1 if the previous frame holds
a force in the block, else 0. A bit j in (a, b) is a mixed bit in contexts 16 a + j and 16 b + j, weights j.

1. Bit 0 in (2 n + held, 2 pattern + held) is 1 if the block moves. `pattern` has three digits of base 3, the first
   neighbour's the highest: 0 it is no candidate, 1 it stands still, 2 it moves.
2. If it moves, its displacement d in quarters of a voxel along x, y, z (c = 0, 1, 2). The prediction p is, for each
   component, the median of the three neighbours if n = 3, else that of the first neighbour that moves, else that of
   the last block that moved, else 0. The residual r = d - p in contexts (8 + 4 c + n, 54 + 5 c + m), m being the
   binary digits of the largest |r| of the components before, at most 4:

```text
bit 0: is r not 0?   if it is 0, nothing follows
bit 1: is r < 0?
l = 1
while l < 8 and bit 1 + l is 1:  l = l + 1          # |r| has l binary digits
v = 1
if l > 1:  v = 2 + bit 7 + l
then l - 2 raw bits (p = 32768), the highest first, each v = 2 v + bit
r = v, or -v if r < 0
```

|d| is at most 64 for each component, d is not 0, and some block moves. The guess is the previous frame, but in a
block that moves the force at sample s is that of the previous frame at s + d / 4: of its up to eight corners with
whole trilinear weights (4 - f or f along each axis, f = d mod 4, 64 in all), those with a force count. If their
weight w is below 32, there is none; otherwise it is floor((sum of weight * vector + floor(w / 2)) / w), component by
component, and none again if its length is below floor(`floor` / 4), the lattice's `floor`. There is none beyond the
grid. The bricks of the guess are those of the previous frame, and those in which such a floor((...) / w) came about,
of length zero or not. With all bricks in which a block moves there may be 4 n + 64 at most, n being those of the
previous frame, at least 1.
"""
