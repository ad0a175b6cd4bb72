"""What the bytes of a surface are: the chapter of the file format."""

from __future__ import annotations

from typing import Final

__all__ = ["SURFACE_CHAPTER"]

SURFACE_CHAPTER: Final = """\
### Guess 2: a surface

The bytes: u8 2 `axis` + `inverted`, `axis` 0, 1, 2 for x, y, z; eight varints, the heads:

| head | below | what |
|---|---|---|
| `top` | 2^17 | an amplitude, units |
| `ramp` | 2^20 | growth of a share from sample to sample, 1/65536 |
| `ratio_a`, `ratio_b` | 2^20 | spacings across over that along, 1/256 |
| `z_step` | 2^12 | step of a start, 1/256 samples |
| `xy_step` | 2^14 | step of a point, 1/16384 |
| `a_step` | 2^16 | step of an amplitude, 1/65536 of it |
| `cut` | 2^17 | the amplitude up to which there is no force, units |

then the tiles, the arithmetic code of the columns, and zero bytes until there is one byte for each tile and one for
every four bricks of the guess. The decoder, tables, mixed bits and end of the code are those of the support.

*Columns* run along `axis`; a, b are the other two axes, ascending, and i, j samples along them. Sample t of a column
is counted from outside: along `axis` it is sample t, or, if `inverted`, the one t before the last of the grid. A
tile is 8 × 8 columns; those of the grid are numbered with a slower than b. The tiles told are in runs: a varint
count, at least 1 and below the length of these bytes, and for each run two varints: how many tiles are left out
before it, from tile 0 on, for later runs from the second tile behind the run before; and how many tiles it has, less
one. There are at most as many tiles as these bytes have bytes.

A column that is present has one or two *surfaces*: a start Z in 1/256 samples, a point (X, Y) of Lambert's equal-area
disc in 1/16384, an amplitude A, 1 to 131071 units. Z is kept within ±2^24, X and Y within ±32767, by the nearest such
number. The point stands for an outward direction (u_a, u_b, u_out) in 1/16384:

```text
n = X X + Y Y
if n > 2^29:  m = (23170 << 14) // root(n);  X = X m >> 14;  Y = Y m >> 14;  n = X X + Y Y     # here only
m = root(2^28 - (n >> 2))
u_a = X m >> 14;  u_b = Y m >> 14;  u_out = max(820, 16384 - (n >> 15))
```

**Code.** The first table has 16896 contexts, the second 8448, and there are 264 sets of weights. Bit j of kind K in
(f, s) is a mixed bit in contexts 64 (22 K + j) + f and 32 (22 K + j) + s, weights 22 K + j. Kinds are: 0 present,
1 still, 2 mode, 3 two, 4 point, 5 start, 6 amplitude, 7 bend, 8 amplitude of two, 9 second start, 10 second point,
11 second amplitude. A *number* of kind K in (f, s):

```text
bit 0: is it not 0?   if it is 0, nothing follows
bit 1: is it < 0?
v = 1
while v <= 20 and bit 1 + v is 1:  v = v + 1          # the size is v, if that is at most 20
if v > 20:  d = 0;  while d < 24 and a raw bit (p = 32768) is 1:  d = d + 1
            w = 1;  d times:  w = 2 w + raw bit;      the size is 20 + w
```

Columns come tile by tile, i slowest; those beyond the grid are left out. W, N, C, E are the columns at (i, j-1),
(i-1, j), (i-1, j-1), (i-1, j+1), if they are present and decoded already; E is absent, too, where j mod 8 is 7 and
i mod 8 is not 0. For a property, [WNCE] is the number whose bits 3, 2, 1, 0 tell whether W, N, C, E are there and
have it. Let few = min(3, how many are there), near(r) = min(|r|, 3). Then, for each column:

1. Bit 0 of kind 0 in ([WNCE], 4 e + 2 [W] + [N]) is 1 if it is present, with e = 2 [i mod 8 = 0] + [j mod 8 = 0].
   The rest is for those that are.
2. `twos` = [WNCE with two surfaces]. `torn` is 1 if W or N has two, or both are there and their (first) Z differ by
   more than 768. Bit 0 of kind 3 in (twos, 4 torn + few): `two`, whether it has two surfaces.
3. If torn, mode = 2 m + m', m bit 0 and m' bit 1 + m of kind 2, in (twos >> 2, two); otherwise mode is 0. The
   columns that it is predicted from, the *sides*, are W, N, C, E in mode 0; W alone in 1; N alone in 2; and in 3 in
   place of W, if that has two surfaces, else in place of N, a column of its second surface alone, with the errors of
   the whole. What is named but not there is an error.
4. Unless `two`: bit 0 of kind 1 in (4 [WNCE still] + few, 4 min(3, how many are still) + few), whether it is *moved*.
   A column of two is moved. A column that is not moved is still, and its residuals r0 to r4 are 0. In what follows
   size(q, m) = w (m + 1) + n, w and n being min(m, size q of W, of N), and m where it is not there.
5. If moved: r0, a number of kind 4 in (size(0, 4), few); r1 in (25 + size(0, 4), 4 + 4 near(r0) + few). X = expected
   X + r0 xy_step, and Y with r1.
6. Z and A are expected (this needs the direction). If moved: r2, of kind 5, in (size(1, 6),
   4 max(near(r0), near(r1)) + few); r3, of kind 8 for two, else 6, in (size(2, 4),
   4 near(r2) + max(near(r0), near(r1)));   unless two, r4, of kind 7, in (size(3, 3), 4 near(r2) + near(r3)). Z =
   expected Z + r2 z_step. A = expected A + r3 step(A'), A' = top for two, else the expected A, step(A') = max(1, A'
   a_step >> 16). The bend is r4, at least -7 and at most 24.
7. Sizes 0 to 3 are |r0| + |r1|, |r2|, |r3|, |r4|. Errors are those of its four predictors, q = 0 to 3:
   error_xy(q) = min(8191, (|X_q - X| + |Y_q - Y|) >> 3), error_z(q) = min(8191, |Z_q - Z|); 512 and 256 if q is not
   known.
8. If two, the second surface. Expected Z, X, Y are the means, rounded down, of the second surfaces of W, N, C, E,
   where there are any. Otherwise they are Z + 1536, X, Y of its first surface; but if any of W, N, C, E has a first Z
   that is larger than Z + 768, those of the one with the largest first Z, the first of equals. Expected A is max(top
   >> 4, top - A). With f = 4 [twos > 0] + near(r2): r7, of kind 9, in (f, 0), r8, of kind 10, in (f, 0), r9, of kind
   10, in (8 + f, 1 + near(r8)), r10, of kind 11, in (f, 0), are the residuals of Z, X, Y, A, in steps z_step,
   xy_step, xy_step, step(top).

**Predictors.** Of the sides: 0 is known if W is there, 1 if N is, 2 if W, N and C are, 3 if W and N are. Of X they
say X_W; X_N; X_W + X_N - X_C; (X_W + X_N) >> 1; the same for Y. Of Z:

```text
rise(u, c, ratio) = u_c ratio // u_out, at least -4096 and at most 4096
0:  Z_W + ((rise(own u, b, ratio_b) + rise(u of W, b, ratio_b)) >> 1)
1:  Z_N + ((rise(own u, a, ratio_a) + rise(u of N, a, ratio_a)) >> 1)
2:  Z_W + Z_N - Z_C;     3:  (predictor 0 + predictor 1) >> 1
```

What is expected is (2 T + w) // (2 w), w the sum over known predictors of max(1, 2^30 // e²), T that of these times
what they say, e = 24 + the sum of their errors (of the point for X and Y, of the start for Z) in all sides. If none
is known, it is X, Y, Z of E, else of C, of the sides, else of the column decoded last, else 0. Expected A: for two,
top >> 1; otherwise, with A of a side being the sum of its surfaces, top if neither W nor N is there; min(top, A) of
the one that is; min(top, the median of A_W, A_N, A_W + A_N - A_C), A_W standing in for A_C if there is no C.

**Forces.** At sample t each surface has the share s = min(65536, max(0, 256 t - Z) g >> 8), with
g = max(16, (ramp u_out >> 14) (8 + bend) // 8), bend 0 for the second, and the deep force D = (A u + 8192) >> 14, by
component. From sample max(0, (Z >> 8) + 1) on, Z the smaller one of two, and where the sum of s A is above
cut × 65536, the force is (sum of s D + 32768) >> 16, each component within ±131071; outward is towards sample t - 1.
The bricks of the guess are, for each tile, those from the first such sample of its columns to the end of the grid
inside; of a tile without any there are none.
"""
