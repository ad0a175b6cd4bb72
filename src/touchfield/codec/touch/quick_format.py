"""What the bytes of a frame of the quick model are: the chapter of the file format."""

from __future__ import annotations

from typing import Final

__all__ = ["QUICK_CHAPTER"]

QUICK_CHAPTER: Final = """\
### Frame model 0: quick

The bytes: the list of bricks, as in the light model; if it is empty, nothing follows. Then:

| part | form | what |
|---|---|---|
| scan | u8 | bits 0-4 as in the light model; bits 5-7: the `usual` way, 1 to 3 |
| slopes | 3 varints | as in the light model |
| code | | the arithmetic code, to the end, of whose last six bytes trailing zeros are left away |

The scan, the reference, O, held, the names of the neighbours, the arithmetic decoder, its contexts (which are plain,
all of them), tiles, their states, the way of a brick and the support of a sample are those of the light model, but
for what is said here. A held sample has a direction u, in 1/65536, an amplitude a, losses, sizes e0 and e1, and a
mark; its vector is

```text
v = (u_c a + 32768) >> 16, for each component c, within ±131071
loss_n = (u_c S) >> 16, ahead_n = a - loss_n, along each axis n of the scan, of component c and slope S
```

The direction and amplitude *of a vector* w are a = max(1, root(w · w)) and u = (w_c (2^34 // a) + 2^17) >> 18.

**Tiles.** State 2: what D holds, its direction and amplitude, with sizes and mark 0. State 3: samples have the
reference's vectors themselves as v, and the direction and amplitude of these, sizes and mark 0.

**Support of a sample.** There is the first context alone, and `wide` is without DD: [DU] + 2 [DL] + 4 [UL].

**What is expected.** u and a are

1. those of the vector o, if O, and the way of the brick is 0 or near is 0;
2. else, if near is 0, those of the first held one of DU, D'U, D'L, DL, U'L, UL; if none is, of the sample decoded
   last in this frame, in a tile of state 1; before that u = (0, 0, 65536) and a = floor;
3. else those of the neighbour D, U or L for way 1, 2 or 3 (of way 0: `usual`), if that is held, of the first of D, U,
   L that is otherwise; with n its axis of the scan, a becomes

```text
next_n = a, if a >= 64512
       = ahead_n, at least max(a >> 3, 1, floor >> 1) and at most 2^18 - 1, otherwise
a = next_n of it, if a < 64512 or no other of D, U, L is held
  = s, if s < 63488, else a;   s the sum of the next_m of the other ones, each along its axis m; >> 1 if there are two
```

**Residual.** e0, e1 are the sums of the sizes of D, U, L, and class(n) is that of the light model:

```text
loud = min(3, a >> 14)
m0 = (e0 M) >> 14, m1 = (e1 M) >> 15,   M = 0, 65536, 32768, 21846 for near = 0, 1, 2, 3
c0 = class(min(31, m0)), c1 = class(min(31, m1)), both 7 if near is 0;   cs = class(min(31, (3 (m0 + 2 m1)) >> 2))
marks = mark of D + 3 mark of U + 9 mark of L
```

Bit [still, 2 (4 (4 cs + near) + loud) + [then >= 4]]. If it is 1, these u and a are the sample's, with sizes and
mark 0. Otherwise there is a residual r0, r1, r2:

1. Bit [aslant, 8 c0 + c1]; if it is 1, bit [zero, 0, 4 c0 + loud], and r0 is 0 if that is 0. Otherwise bit
   [sign, marks], 1 for below zero, and the size of r0, as that of the light model, of contexts [size, 0, c0, k].
   The mark is 0, 1 or 2 for r0 = 0, above 0, below 0, and e0 = min(15, |r0|).
2. If aslant is 1, for r1 and then r2: bit [zero, n, 4 c1 + min(3, |r before|)], n being 1 and 2, the one before r0
   and r1; not for r2 if r1 is 0: then r2 is not 0. If it is 1, bit [sign, 27 or 28] and the size, of contexts
   [size, 1, c1, k]. e1 = min(31, |r1| + |r2|).

Where r0 is not 0, with b(0) to b(N) the borders of the lattice, b(i) <= 256 a < b(i + 1), and j = i + 16 r0,

```text
A = -min(b(min(-j, N)) >> 8, 2^18 - 1), if j < 0
  = min((b(min(j, N)) + 256 a - b(i)) >> 8, 2^18 - 1) otherwise
```

and A = a where it is. If aslant is 0, A is the new amplitude, and if A <= 0, the direction is -u and the amplitude
max(1, -A). If it is 1, with t the cross step at |A|, within ±2^20 after it is multiplied by r1 or r2, direction and
amplitude are those of the vector w, or of (0, 0, 1) if it is zero:

```text
g = |u_z| < 58982 ? (-u_y, u_x, 0) : (0, -u_z, u_y)
i = 2^32 // root((2 n + 1) 2^21),   n = min(1023, (g · g) >> 22)
h = (g_c i) >> 16
k = ((u_y h_z - u_z h_y) >> 16, (u_z h_x - u_x h_z) >> 16, (u_x h_y - u_y h_x) >> 16)
w = (A u + r1 t h + r2 t k + 32768) >> 16, each component within ±131071
```
"""
