"""What the bytes of a frame of the light models are: the chapter of the file format."""

from __future__ import annotations

from typing import Final

__all__ = ["LIGHT_CHAPTER"]

LIGHT_CHAPTER: Final = """\
### Frame model 1: light

The bytes: a chunk, the list of bricks: a support (given, where the previous frame is known, that of all samples of
its bricks) of bricks that are all full; if it is empty, nothing follows. Then:

| part | form | what |
|---|---|---|
| scan | u8 | bits 0-1: the slowest axis, 0 to 2; bits 2, 3, 4: the slowest, middle, fastest is walked downwards |
| slopes | 3 varints | below 2^18, for each axis of the scan: 2 S for S >= 0, -2 S - 1 below |
| way | u8 | 64 `usual` + `mix`; `mix` is 0 if `usual` is |
| classes | u16 | bit n: class n has weights of its own; those of the others are 0 |
| weights | 13 × i8 each | of these classes, ascending, in 1/64; i8 is a byte with sign |
| code | | the arithmetic code, to the end, of whose last six bytes trailing zeros are left away |

**Scan.** The axes of the scan are the slowest one and the other two, ascending. A sample (p, q, r) of the scan has
the index along each of these axes, counted from the far end of the last brick where it is walked downwards. *Planes*
have equal p, ascending; in a plane, each listed brick that has samples in it has a *tile* of them, and tiles come
with q slower than r. All that follows is in these coordinates, but for the components of vectors, which stay x, y, z.

The *reference* is the guess, if there is one, else the previous frame, if it is known, else nothing; it counts in
listed bricks alone. O(p, q, r) tells that it has a force there, o its vector. A sample that is decoded with a force
is *held*: it has a vector v (zero at times), an amplitude a, two sizes e0, e1, a pin, and an amplitude ahead along
each axis n = 0, 1, 2 of the scan, of vector component c and slope S:

```text
ahead_n = a - ((((v_c (2^28 // a)) >> 14) S) >> 14)
```

All these are 0 where no force is held: beyond the grid, in bricks that are not listed, at samples still to come. The
three neighbours D, U, L of (p, q, r) are at (p-1, q, r), (p, q-1, r), (p, q, r-1); DU is at (p-1, q-1, r), D'U at
(p-1, q+1, r), D'L at (p-1, q, r+1), DL at (p-1, q, r-1), U'L at (p, q-1, r+1), UL at (p, q-1, r-1), DD at (p-2, q,
r).

**Arithmetic decoder.** x = the first six bytes, the first one highest, `range` = 2^48; zeros behind the end. A bit
whose chance to be 1 is P / 65536:

```text
bound = (range >> 16) P
bit = x < bound ? 1 : 0
if bit: range = bound     else: x = x - bound, range = range - bound
if range < 2^32:  x = x 2^16 + the next two bytes, the first one higher;  range = range 2^16
```

With u bytes used at the end, the six first ones counted, the code has at least u - 6 and at most u bytes. Contexts
are as those of the support, at first 2^21 of 2^22 and no visits, and learn as they do, but visits grow to 126. A
*plain* bit has P = chance >> 6, but at least 8 and at most 65528. A *mixed* bit has three contexts and three weights,
at first 26214 each, x = (wa a + wb b + wc c) >> 16, and else is as that of the support. Bits for which three contexts
are given are mixed, the others plain. Contexts and weights are named by what stands in brackets; those of different
names or numbers are different.

**Tiles.** `deep`: the tile before, at p - 1, holds a force; `old`: the reference has one in the tile; `listed`: the
brick is one of the reference's. With t = 3 (T(p-1) + 4 T(R-1) + 16 T(Q-1)) + old + listed, T the states of the tiles
before along p, r, q, 0 where there is none:

```text
plain bit [coded, t] = 1:                        state 1
else if not deep and not old:                    state 0
else plain bit [something, t] = 0:               state 0
else if deep and old: plain bit [reference, t]:  state 3 if 1, 2 if 0
else                                             state 3 if old, 2 if deep
```

State 0: no force. 2: what D holds, with the same amplitudes, sizes and pin 0, is held by each sample. 3: samples have
the reference's vectors, a = max(1, length), sizes and pin 0. 1: each sample is coded, q slower than r.

If `usual` is not 0, the *way* of a brick, 0 to 3, is told before the samples of its first tile of state 1: with
w = 5 W(Q, R) + W(Q, R-1), W being 1 + the way told last of a brick at this place along q and r, 0 if none was, a
plain bit [way high, w], and a plain bit [way low, w, the high bit]; the way is 2 high + low.

**Support of a sample.** [X] is 1 if X is held, near = [D] + [U] + [L], then

```text
mask  = [D] + 2 [U] + 4 [L] + 8 [D'U] + 16 [D'L] + 32 [U'L]
wide  = [DU] + 2 [DL] + 4 [UL] + 8 [DD]
bin(t) = ((28 t) >> 16) + 3, at least 0 and at most 31
t     = ahead_0 of D + ahead_1 of U + ahead_2 of L, of those held;  t >> 1 if near is 2, (21845 t) >> 16 if it is 3
about = how many of O(p, q, r+1), O(L), O(U), O(D) are there
then  = 0 if not listed, else if O: 4 + [about >= 3] + [about = 4], else 1 + [about >= 1] + [about >= 3]
ahead = near ? bin(t) : wide
```

The bit "held" has contexts [held, 512 ahead + 8 mask + then]; [wide, 8 (64 (wide + 16 [(p, q-2, r)] +
32 [(p, q, r-2)]) + mask) + then]; [bins, 2 (256 b0 + 16 (b1 >> 1) + (b2 >> 1)) + [then >= 4]], with b0, b1, b2 the
bins of ahead_0 of D, ahead_1 of U, ahead_2 of L, 0 where not held; weights [held, 8 near + then].

**What is expected.** If `usual` is not 0, the way of the brick is followed. If that is 0 and O, E = o, and the
reference is followed, unless it is off: D is held and O(D), and the sum of the squares of v(D) - o(D) is above the
square of the step along a of D. Otherwise the neighbour followed is D, U or L for way 1, 2 or 3 (of way 0: `usual`),
if that is held, else the first of D, U, L that is; n is its axis of the scan, and C its vector v of amplitude a made
longer or shorter:

```text
l = ahead_n of it, if a < 64512
  = (sum of x) // how many, if a >= 64512 and the other two of D, U, L that are held have a sum of x below
    63488 × how many (x = their a if that is 64512 or more, else their amplitude ahead along their own axis)
  = a otherwise
l = max(l, a >> 3, 1, floor >> 1)
C = (v m + 8192) >> 14, each component within ±131071,   m = l = a ? 16384 : min(2^17, (l 2^14) // a)
```

E is C + (((blend - C) mix) >> 6), and, where nothing is followed (no neighbour is held, or `usual` is 0), the blend
itself. The *blend* has a base B, and the class c = [D] + 2 [U] + 4 [L] + 8 [O] of
13 weights w:

```text
near > 0:  A = sum of max(ahead, a >> 3) of D, U, L that are held (ahead_0, ahead_1, ahead_2)
           m = min(2^18, (A 2^16) // (near × sum of their a));   B = (sum of their v × m + 32768) >> 16
near = 0:  B = o if O, else v of the first held one of DU, D'U, D'L, DL, U'L, UL, else the vector coded last
           in this frame, in a tile of state 1; before that (0, 0, floor)
s = 32 + w0 v(D) + w1 v(U) + w2 v(L) + w3 v(D'U) + w4 v(D'L) + w5 v(U'L);   W = sum of w0 .. w5 where held
s = s + w6 (v(D) - v(DD)) + w7 (v(U) - v(DU)) + w8 (v(L) - v(DL)) + w9 (v(L) - v(UL)) + w10 (v(U) - v(UL)),
        each where both are held
if O:  s = s + w11 o;   W = W + w11
       n = how many of D, U, L are held and have O;  if n > 0:
       s = s + ((w12 (64 // n) × sum of their v - o) >> 6)
blend = B + ((s - W B) >> 6), each component within ±131071; if all weights of all classes are 0, B within ±131071
```

**Residual.** a = root(E · E); if it is 0, E_z = 1 and a = 1. e0 and e1 are the sums of the sizes of D, U, L;
class(n), n at most 31, is 0, 1, 2, 2, 3, 3, 3, then 4 four times, 5 five times, 6 eight times and 7 from then on.

```text
loud  = min(15, a >> 12)
c0    = near ? class((4 e0) // near) : 7;   c1 = near ? class((2 e1) // near) : 7
cs    = class((3 (e0 + e1)) // max(1, near))
n0    = min(3, e0 of D) + 4 min(3, e0 of U) + 16 min(3, e0 of L);   n1: the same of e1
X     = (blend where something is followed, else B with each component within ±131071) - E
apart = binary digits of (32 root(X · X)) // (3 × step along a), at most 7
new   = (step along a) >> 3, at least 1 and at most 32767
old   = the pin of the neighbour that is followed; new where none is
pin   = ratio((16 old) // new, at most 63), 0 where no neighbour is followed
quiet = 16 n(D) + 4 n(U) + n(L),  n = 0 if not held, else 1 + min(2, e0 + e1)
```

ratio(n) is 0 up to 16, 1 at 17, 2 up to 19, 3 up to 22, 4 up to 26, 5 up to 31, 6 up to 44, 7 from then on.

Bit "still", with t = 2 (4 (4 cs + near) + min(3, loud)) + [then >= 4]: [still, 4 t + (pin >> 1)]; [still near,
8 (8 quiet + pin) + apart]; [still apart, 4 (16 apart + loud) + near]; weights [still, cs]. If it is 1, v = E, with
this a, sizes 0 and the pin `old`.

Otherwise the residual r0, r1, r2 follows. It is about F, which is the blend where something is followed, else E; in
the first case X = -X. From here on, a = root(F · F), and the step is that along it; if a is 0, F_z = 1 and a = 1. On
axis c of those along F, `toward` is the binary digits of (8 |x|) // (step along a), at most 7, and `side` is 1 if
x < 0, with x = (X · axis c) >> 14. With R(n) = min(3, |n|), for c = 0, 1, 2:

1. Bit "not zero": [c, c = 0: 8 c0 + min(7, loud); 1: 4 (4 c1 + R(r0)) + min(3, loud); 2: 4 (4 c1 + R(r0)) + R(r1)];
   [c near, n0, or n1 for c > 0]; [c toward, 4 (8 toward + (c = 0: min(7, loud); else c1)) + (c = 0: 0; else R of the
   component before)]; weights [c, c0]. For c = 2, if r0 and r1 are 0 and nothing is followed, there is no
   such bit: r2 is not zero.
2. If not zero, a plain bit [sign, c, near, toward, side], 1 for below zero; then the size: from k = 1 on, bits, 0 if
   the size is k, up to k = 14: [size, c, c = 0: c0; else c1, k]; [size toward, c, toward + 8 if `toward` is not 0 and
   the sign is `side`, c = 0: c0; else c1, k]; [size last, c, c = 0: loud; else the size of the component before, at
   most 15, k]; weights [size, c, k]. Behind 14 ones, n raw bits (P = 32768) of 1, 17 at most, and below 17 of them
   one of 0; then n raw bits, the highest first: the size is 14 + 2^n + their number.

Then, along F, with level and amplitude as above: A = amplitude(level(a) + 256 r0), m = the cross step at |A|,
v = rebuilt(A, r1 m, r2 m) on the axes along F, a = max(1, root(v · v)), e0 = min(15, |r0|), e1 = min(31, |r1| +
|r2|), and the pin is `new`. A vector of zero is held while the frame is decoded, and is no force in the frame.
"""
