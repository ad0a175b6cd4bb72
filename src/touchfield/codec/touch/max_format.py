"""What the bytes of a frame of the max model are: the chapter of the file format."""

from __future__ import annotations

from typing import Final

__all__ = ["MAX_CHAPTER"]

MAX_CHAPTER: Final = """\
### Frame model 2: max

| part | form | what |
|---|---|---|
| orientation | u8 | 8 o + f; o = 0 to 5: the grid's axes (slowest, middle, fastest) are 012, 021, 102, 120, 201, \
210; bits 0, 1, 2 of f: the slowest, middle, fastest is walked downwards |
| metric | 3 × u8 | less 1: M_x, M_y, M_z, the spacing of the fastest, middle, slowest axis in 1/256 of the largest |
| slope | varint | S, 65536 at most |
| bricks | chunk | the list of bricks: a support, given none, of bricks that are all full |
| share | u8 | of the mean in a prediction that follows one way, in 1/256 |
| code | | one arithmetic code of all else, to the end |

Nothing follows an empty list of bricks, and such a frame teaches nothing. With n bricks, the two longest sides of the
box about them, in bricks, have a product of at most 64 n + 1024. Decoder, tables and end of the code are those of the
support; code bytes it has not used and its ending fill the payload exactly.

**The pass.** All that follows is in the coordinates of the pass: z the slowest axis, y the middle, x the fastest,
counted from the far end of the last brick of the grid where an axis is walked downwards; vectors have their
components in the order x, y, z of the pass, negated where the axis is walked downwards. Bricks are ordered by
(Z, Y, X). Z, then z in it, ascends; in a plane z, for each Y that has bricks in this layer, y ascends; in a row, its
bricks come by X, and in each x ascends. Samples beyond the grid are left out. The *state* of a brick is decoded just
before the first of its samples.

v(x, y, z) is the vector decoded there, a = max(1, root(v · v)) its length; *held* are samples with a vector other
than 0; all others, also those to come and those in bricks that are not listed, have v = 0 and a = 0. W is the
previous frame, where it is known, G the guess, both with what they have within the box of the listed bricks alone,
and 0 elsewhere. `inter` is 1 if W has a brick (of force or not) in the box, plus 2 if G has; [W], [G] are its bits.

The causal *neighbours* n = 0 to 12, at distances (dx, dy, dz): 0 to 8 have dz = -1, with 3 (dy + 1) + dx + 1 = n;
9 to 12 are (-1,-1,0) (0,-1,0) (1,-1,0) (-1,0,0). X, Y, Z name neighbours 12, 10 and 4. With d the sum of squares of
the distances, `once` is 256 // d and `twice` 256 // d². Sums over n are over those held, k of them.

Each place (x, y, z mod 3) keeps *marks*, that of the last held sample there: three sizes s_x, s_y, s_z, a pin, and
errors E_j, F_j of the experts j = 0 to 4. Where a sample is not held, its sizes and its pin count as 0.

**Mixed bits.** There are two models of bits, *support* and *residual*. Each has chances (2^21 of 2^22 and no visits
at first; they learn as those of the support), sets of weights by number (each weight 10486 at first) and maps by
number. A bit is given by contexts (which, value), further logits, two sets of weights, and a map:

```text
slot of (i, c):  h = c >> 4,  h = (h xor (h >> 23)) mod 2^32;
                 65536 i + ((((2654435761 h) mod 2^32) >> 16) xor (c & 15))
inputs t: stretch[chance >> 10] of the slot of each context, then the further logits, then 77
x1 = (sum of w1 t) >> 16,  x2 = (sum of w2 t) >> 16, each at least -3072 and at most 3071
x  = (x1 + x2) >> 1;   u = x + 2048, at least 0 and at most 4095;   i = u >> 7;   r = u & 127
P  = (154 squash[x] + 102 ((map[i] (128 - r) + map[i+1] r) >> 7)) >> 8, at least 4 and at most 65532
decode the bit with P;   e = 65536 bit - squash[x1] for w1, 65536 bit - squash[x2] for w2
w      = w + ((t e + 8192) >> 14), for each weight of both sets
map[i] = map[i] + ((65536 bit - map[i]) (128 - r)) // 6400;   map[i+1]: the same with r for 128 - r
each slot learns the bit
```

A map has 33 numbers, map[i] = squash[128 (i - 16)], its argument at least -3072 and at most 3071. logit(p) is
stretch[p >> 4], with p at least 0 and at most 65535. Slots that are equal share a chance.

**States of bricks.** `full` is a quarter, rounded down, of how many of the 16 samples of the brick's tile in the
plane before, z - 1, at even x and y, are held. A bit has two contexts of model residual, of which 10 and 11:

| bit | contexts 10, 11 | weights | map |
|---|---|---|---|
| copied | 4 full + inter; inter | 380, 381 + full | 180 |
| another field, if copied and inter > 0 | 256 + 4 full + inter; 256 + inter | 386, 387 + full | 181 |
| guess, if that and inter = 3 | 512 + full; 512 | 392, 393 + full | 182 |
| way, if not copied: 3 bits j, the highest first | 16 (1024 + 8 full + b) + 2^j + w; 16 (1024 + 8 u + b) + 2^j + w \
| 398, 399 + j | 183 + j |

w is the number of the bits of the way before; b is 1 + the way of the brick before in the list, u that of the brick
at (X, Y, Z - 1), and 0 if there is none or it has none. Three bits of 0: the brick has no way; else the way is their
number, 5 at most, less 1: 0, 1, 2 follow z, y, x; 3 follows the guess, 4 the previous frame. A copied brick takes
for each sample v(x, y, z - 1), or what W or G has there; where that is not 0 the sample is held, and its mark becomes
sizes 0, the pin of the place (x, y, z - 1), and all errors 4. In other bricks each sample is decoded as follows.

**Transitions.** At corners (i, j), i = 0 to 16, j = 0 to 7, of length and step, there are a change, a deviation, a
weight and a chance; at first

```text
change = (4096 i + (((128 j - 448) S) >> 8), at least 0 and at most 65536) - 4096 i
deviation = 6000,   weight = 768,   chance = 45875
place(a, q):  l = min(a, 65535) >> 4,  i = l >> 8,  r = l & 255;
              m = 2 (q + 448), at least 0 and at most 1791,  j = m >> 8,  s = m & 255
look up:      (T[i,j] (256-r)(256-s) + T[i,j+1] (256-r) s + T[i+1,j] r (256-s) + T[i+1,j+1] r s) >> 16
learn chance (a, q, held):  at corner (i + (r >> 7), j + (s >> 7)):
              chance = chance + ((held ? 65535 : 0) - chance) // 50
learn change (a, q, c):  at each of the four corners, w its product of two as in `look up`, >> 8; if w > 12:
              weight = min(weight + w, 102400);   o = c - change
              change = change + (o w) // weight;   deviation = deviation + ((|o| - deviation) w) // weight
```

**What the neighbours say.** For each held neighbour n of vector v, length a, distances (dx, dy, dz):

```text
q = (v_x dx M_x + v_y dy M_y + v_z dz M_z) // a;    change, deviation, chance: look up (a, q)
f = max(a + change, 1300);   D = max(deviation, 1);   w = (twice × 2^24) // (D² + 1600000) + 1
taylor = (sum of w ((v ((f 2^12) // a)) >> 12)) // (sum of w);    mean = (sum of twice v) // (sum of twice)
length = (sum of w f) // (sum of w);    odds = (sum of once logit(chance)) // (sum of once)
surest = f, least = D, of the least D, the first one of equals;   bits = sum of 2^n
```

Without any, length, odds and surest are 0, least is 2^40.

**Support of a sample.** Model support. size(a) is 0 for 0, else 1 + min(a >> 12, 14), and Qx, Qy, Qz that of X, Y,
Z; gx, gy, gz are (q + 256) >> 6 of X, Y, Z if held, else 9, at least 0 and at most 15. If k > 0:

```text
o = ((2 odds + 128) >> 8, at least -8 and at most 8) + 9
t = ((29 length) >> 16) + 10, at least 0 and at most 39;   s = ((23 surest) >> 16) + 8, at least 0 and at most 31
```

else o = 0, t = s = 40. `far` is the number whose bits 0 to 8 tell what is held at (-2,0,0) (0,-2,0) (0,0,-2) (2,-1,0)
(2,0,-1) (0,2,-1) (1,-2,0) (0,1,-2) (1,0,-2). `cross` is bits 1, 3, 5, 7 of `bits`, as bits 0 to 3. Of another field,
`seven` is the number whose bits 0 to 6 tell where it has a force: (0,0,0) (-1,0,0) (1,0,0) (0,-1,0) (0,1,0) (0,0,-1)
(0,0,1); `all` is that of all 27 about, x fastest, z slowest, from (-1,-1,-1) on; Qo is size(a) of it here.

| which | context | which | context |
|---|---|---|---|
| 0 | bits | 4 | 16 (16 (16 Qz + gz) + (bits >> 9)) + cross |
| 1 | 512 bits + far | 5 | 512 (16 Qx + gx) + 16 Qy + gy |
| 2 | 64 (64 o + t) + s | 6 | 8 (16 o + k) + (far & 7) |
| 3 | 32 (32 Qz + Qy) + Qx | 7 | 32 (16 Qz + gz) + o |
| [W] 8 | all | [G] 13 | all |
| [W] 9 | 64 seven + t | [G] 14 | 32 (32 Qo + o) + Qz |
| [W] 10 | 32 (32 Qo + o) + Qz | [G] 15 | 32 (64 seven + s) + Qo |
| [W] 11 | 8192 seven + bits | [G] 16 | 8192 seven + bits |
| [W] 12 | 32 (32 (32 Qo + Qz) + Qx) + Qy | | |

Contexts 0 to 7, those of [W] if inter & 1, those of [G] if inter & 2; then the further logit `odds`; weights
family, 16 family + k + 2, where family = [inter > 0]; map o. But if k = 0 and inter = 0: contexts 0 and 1 alone,
the logit as before, weights 32, 2. Then, if k > 0 and (k < 13 or the sample is not held),
each held neighbour with d <= 2 learns the chance (a, q, held).

**Candidates.** If k = 0, taylor = mean = W here if [W] and it has a force, else the vector of the last held sample in
the order of the pass, before any (0, 0, -21845). T is `taylor`. Each candidate is T where one of the samples it
is made of is not held (of 2 X - X2 and the like: X2, Y2, Z2 are at (-2,0,0) (0,-2,0) (0,0,-2)):

| | | | |
|---|---|---|---|
| c0 = T | c1 = mean | c2 = X | c3 = Y |
| c4 = Z | c5 = 2 Z - Z2 | c6 = 2 X - X2 | c7 = 2 Y - Y2 |
| c8 = X + Y - (-1,-1,0) | c9 = X + Z - (-1,0,-1) | c10 = Y + Z - (0,-1,-1) | c11 = (1,0,-1) |
| c12 = (0,1,-1) | c13 = (-1,0,-1) | c14 = (0,-1,-1) | c15 = (1,-1,0) |
| c16 = W | c17 = W + u | c18 = G | c19 = G + u |

u is the mean, rounded down, of X - W there, Y - W there, Z - W there, of those held here and there, or 0; for c19
with G. c16 to c19 are T where W or G has no force here. At last, if k = 0 and G has a force here, c0 is c18. m is 19
if inter > 0, else 15.

**Least squares.** step = max(floor, (root(c0 · c0) rate) >> 16) is halved, rounding down, `shift` times until it is
below 64. cut(n) = (n + ((1 << shift) >> 1)) >> shift, at least -1023 and at most 1023. Each sample decoded so keeps
its differences D_i = c_i - c0, i = 1 to m, and D_0 = v - c0, what came. Its window: the samples so decoded (not
copied) at (dx, dy, dz) before this one in the order of z, y, x, with dx, dy from -2 to 2, dz from -2 to 0 and
|dx| + |dy| + |dz| <= 4, of weight w = max(1, 24 // (dx² + dy² + dz²)); no more than 24, the nearest by
dx² + dy² + dz², of equals those first in the order of z, y, x. Sums over the window and the components:

```text
A_ij = sum of w cut(D_i) cut(D_j);   B_i = sum of w cut(D_i) cut(D_0);   trace = sum of A_ii
known = sum of (A'_ii >> 3);   if known > 0:   share = (4096 (trace + 64)) // (2 known + 1)
    B_i = B_i + (((B'_i >> 3) share) >> 12);   A_ij = A_ij + (((A'_ij >> 3) share) >> 12)
descend(A, B, prior, ridge, x), once:  for i = 1 to m:
    g = 2^14 B_i - sum of A_ij x_j + ridge (prior_i - x_i);   h = A_ii + ridge
    if h > 0:  x_i = x_i + g // h, at least -65536 and at most 65536
slow weights x':  descend(A', B', ridge 0, x') once
weights x:        x = x' at first;  descend(A, B, prior x', ridge (trace >> 10) + 200, x) four times
```

A', B', x' are 0 at first. When the sample is decoded, with the `shift` it had:
A'_ij = A'_ij + 8 (sum of cut(D_i) cut(D_j)) - (A'_ij >> 13), and B'_i with cut(D_0) for cut(D_j). If then an A'_ii
is above 2^32, all A' and B' are halved, rounding down.

**Experts.** by(x) = c0 + ((sum of x_i D_i + 8192) >> 14), each component within ±131071; c0 if its length is above
81920 (by squares).

```text
expert 4 = by(x);   expert 1 = by(x');   expert 0 = (expert 4 + expert 1) >> 1
expert 3 = c19 if inter & 2, else c17 if inter & 1, else c1
expert 2: way 0, 3, 4 or none: l = length(Z);  way 1: l = length(Y);  way 2: l = length(X); c0 if that is not held:
   a >= 64512:  l = a if length >= 63488, else length;   else  l = max(a + ((S q) >> 8), 656)
   its v if l = a, else (v l) // a
   way 3, 4: G, W here instead, if it has a force, unless Z is held, it has a force (vector g of length b) at Z
   as well, and |v(Z) - g|² > max(floor, (b rate) >> 16)²
if the brick has a way: experts 0 and 2 change places; then expert 0 = expert 0 + (((expert 2 - expert 0) share) >> 8)
```

p is expert 0, each component within ±131071; if its length is below 8, 16 is taken from p_z.
a = root(p · p), below 2^18, is its length from here
on, (e, h, k) are the axes along p, called axes 0, 1, 2, and step = max(floor, (a rate) >> 16).

**Contexts of the residual.** half(n) is 2 b + (the second highest binary digit of n), b its number of digits; 0 for
0, 2 for 1. level(n) is half(n) - 6, at least 0 and at most 15. Over held neighbours: N = sum of twice,
R = sum of twice s_x, C = sum of twice (s_y + s_z), and the sums of twice E_j and twice F_j.

```text
mr = (256 R + 13107) // (N + 128);  mt = (128 C + 13107) // (N + 128);  if N = 0: both at least 512
unseen = 24640 if N = 0, else 0
qr = level(mr);  qt = level(mt);  qa = min(a >> 12, 15);  qn = k
qv = k > 0 ? level((128 min(least, 2^20)) // step) : 16
sp = level((256 root((sum over i = 0 to m of |c_i - p|²) // (m + 1))) // step)
mm = [X held] + 2 [Y held] + 4 [Z held] + 8 [[W] and W has a force here]
ps = level((256 root(|W - p|²)) // step) if [W] and it has a force here, else
     100 + level((256 root(|c18 - p|²)) // step) if [G], else 300 + inter
quiet = 9 n(X) + 3 n(Y) + n(Z),  n = min(2, s_x + s_y + s_z)
trio_c = 16 n(X) + 4 n(Y) + n(Z),  n = min(3, s_c),  for c = x, y, z
rx, ry, rz: of X, Y, Z if held, half((16 pin) // step) - 6, at least 1 and at most 15; else 0
pin = (pin(X) + pin(Y) + 2 pin(Z)) // (1, 1, 2 in all of those held), of those held; step if none is
centre_cj = 256 (((expert j - p) · axis c) >> 14) // step, at least -100000 and at most 100000
spread_cj = max(12, root(4096 ((E + 616 + unseen) // (N + 77) + 1)) >> 1),  E that of E_j for c = 0, of F_j for 1, 2
below(b, c, s) = squash[(256 (b - c)) // s], the argument at least -3072 and at most 3071
within(c, s) = max(8, below(128, c, s) - below(-128, c, s))
```

All bits have ten contexts, which 0 to 9, with five further logits of the experts, of model residual. w is 1 if the
brick has a way, else 0. First, *moved*: contexts 8 n + 4 w with these n, weights w, 2 + qr, map 120 + qt, logits
logit(65536 - P), P = 65536, then P = (P within(centre_cj, spread_cj)) >> 16 for c = 0, 1, 2:

| 0 | 1 | 2 | 3 | 4 |
|---|---|---|---|---|
| 32 (16 qr + sp) + qt | 32 (16 qr + qt) + qv | 16 (16 sp + qa) + mm | 16 ps + qr | 16 (16 qn + mm) + qa |

| 5 | 6 | 7 | 8 | 9 |
|---|---|---|---|---|
| 16 quiet + mm | 16 (16 ps + sp) + qa | 16 (32 qa + qv) + quiet mod 9 | 16 (16 rz + ry) + rx | 16 (16 rz + qr) + qa |

If it is 0, r = (0, 0, 0). Else r0, r1, r2 follow, c = 0, 1, 2, with q = qr for c = 0, else qt; R(n) = min(3, |n|);
b = 0, 4 R(r0), 4 R(r0) + R(r1); u1, u2 = (3 centre_c2) >> 9, (3 centre_c3) >> 9, at least -3 and at most 3, plus 3;
for c = 2 the spreads are (4 spread_1j + 128 min(|r1|, 20)) // 5 + 1. The contexts are 32 (8 n + 4 w + c + 1) + bit:

| 0 | 1 | 2 | 3 | 4 |
|---|---|---|---|---|
| 16 (16 q + sp) + b | c = 0: 32 (16 qr + qt) + qv; else 16 (16 qr + qt) + b | 16 (16 (16 sp + qa) + mm) + b \
| 16 (16 ps + q) + b | 16 (16 (16 qn + mm) + qa) + b |

| 5 | 6 | 7 | 8 | 9 |
|---|---|---|---|---|
| 16 (16 trio_c + mm) + b | 16 (16 (7 u1 + u2) + q) + b | 16 (16 (32 qa + qv) + q) + b \
| 16 (16 (16 rz + q) + qa) + b | 16 (16 (16 rz + ry) + rx) + b |

With g = min(q >> 1, 7), B = 20 + 60 c, and centre, spread of c and expert j in `within` and `below`:

| what | bit | logits | weights | map |
|---|---|---|---|---|
| not zero; left out for c = 2 if r0 = r1 = 0 | 0 | logit(65536 - within) | B, B + 1 + g | 30 c + g |
| above zero | 1 | logit((2^16 up) // max(1, up + below(-128))), up = 65536 - below(128) | B + 9, B + 10 + g \
| 30 c + 8 + g |
| size above n, n = 1 to 19, until it is 0 | 1 + n | logit((2^16 (65536 - below(256 n + 128))) // \
max(1, 65536 - below(256 n - 128))), of -centre where r_c < 0 \
| B + 17 + min(n, 6), B + 24 + g | 30 c + 16 + min(n, 7) |

Behind 19 ones, raw bits (P = 32768): n ones, 20 at most, and below 20 a zero; then n bits, the highest first: the
size is 19 + 2^n + their number.

**The force.** If r is 0, v = p. Otherwise A = a if r0 = 0, else amplitude(level of amplitude a + 256 r0); M is the
cross step at |A|, L = 524284 // M; v = rebuilt(A, r1 M, r2 M), with r1, r2 at least -L and at most L; (0, 0, 1) if
that is 0. The mark becomes: sizes min(200, |r_c|); the pin above if r is 0, else `step`; and, with
d = (16 (v - expert j)) // step, each component at least -3000 and at most 3000, and t = (d · axis 0) >> 14:
E_j = min(6400, t² >> 4), F_j = min(6400, max(0, d · d - t²) >> 5). At last, each held neighbour with d <= 2 learns
the change (a, q, max(1, root(v · v)) - a), a and q its own.

**What is learnt** from one frame of this model to the next that has bit 3 set: both models of bits altogether; and
by orientation the transitions (S of the first frame in it) and A', B', x'. Windows, marks and the last vector begin
anew in each frame.
"""
