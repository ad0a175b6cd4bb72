"""What the bytes of a frame that is kept to the bit are: the chapter of the file format."""

from __future__ import annotations

from typing import Final

__all__ = ["LOSSLESS_CHAPTER"]

LOSSLESS_CHAPTER: Final = """\
### Frame model 3: kept to the bit

Forces are float32 to the bit here: -0.0 is another number than 0.0, and a sample is supported if any bit of its force
is set. The bytes: a chunk, the support, coded given that of the previous frame if that is known; nothing more if it
is empty. Then a u8: 0, and three f32 for each supported sample follow; or 1, and a palette and the code of the
symbols follow. Samples are in the order of bricks (ascending, x slowest), and of x, y, z, z fastest, in each.

**Values** are told as: f32 `unit`; varint n, 1 or more; a chunk, the *whole numbers* g(0) .. g(n-1), s(0) .. s(n-1).
m(0) = g(0), m(i) = m(i-1) + g(i) + 1. If the unit is 0, the magnitudes are the float32 whose bits are m(i), below
0x7f800000; otherwise m(i) × unit, one float32 product each, ascending and finite, m(i) below 2^18. s(i) is 1 if the
magnitude is a value, 2 if its negative is, 3 if both are. The values are the negatives, from the largest magnitude to
the smallest, and then the others, ascending. *Whole numbers* of up to 31 bits are in an arithmetic code whose
decoder, mixed bits and end are those of the support, with 2560 contexts in the first table, 66048 in the second, and
40 sets of weights. L and M are the numbers of binary digits of the last number and of the one before it, at first 0:

```text
node = 1;  5 times:  bit in (32 L + node, 32 (32 L + M) + node), weights node;  node = 2 node + bit
l = node - 32;  v = l > 0 ? 1 : 0                         # the number of binary digits
l - 1 times:  v = 2 v + bit;   the first three times a bit in (2048 + 8 l + v mod 8, 65536 + 8 l + v mod 8),
              weights 32 + v mod 8, then a raw bit (p = 32768)
```

**Palettes.** u8 kind. N is the number of supported samples.

| kind | then | planes and their sizes | a vector is |
|---|---|---|---|
| 0 | | 12 of 256 | the bytes of x, y, z, the highest of each first |
| 1 | values, at most min(3 N, 2^18) | 3, values | the values of its symbols |
| 2 | values, at most 3 m; varint k, 1 to m = min(N, 2^16); chunk | 1, k | entry of a list |
| 3 | u8 length and name of a codebook; values | 2: values, vertices | value × vertex, float32 products |

The values of kind 3 are not negative, and min(N, 2^18 // vertices) at most. The chunk of kind 2 is the code of k
vectors as of kind 1, in *symbols* as below, each with the one before it in the list as its neighbour along z, and
nothing else beside it; they ascend strictly. The *symbols of a vector* in a palette are those that stand for it to
the bit, of kind 3 the first pair where there are more.

**Symbols.** The arithmetic decoder is that of the support, to the end of the bytes. There is one table of T contexts,
T = 4096 doubled until it is at least min(2^22, 16 × samples × planes); a context is taken mod T. They learn as those
of the support do. A bit *mixed* of k contexts with a set of weights (at first 19660 each) is as there, with k inputs,
x = (sum of w s) >> 16, and each weight kept within ±2^22 after it has changed. The hash H of numbers:

```text
H(a) = a;   H(a, ..., y, z) = (t xor (t >> 19)) mod 2^22,   t = ((H(a, ..., y) xor z) mod 2^22) 0x2f0b4c47 + z
```

Each sample has neighbours z, y, x (one before it along that axis) and zy, zx, one before along both, among the
supported ones; one in another brick is there only if all bricks on the way to it, along x, then y, then z, are of the
support. t is the same sample in the previous frame, if that is known and the palette has the symbols of its force
((0, 0, 0) where it has none). "Same" means all symbols are equal. With [..] 1 or 0, for each sample in order:

```text
pattern = [t] + 2 [z] + 4 [y] + 8 [x] + 16 [z same y] + 32 [z same x] + 64 [y same x]
          + 128 [t same z] + 256 [t same y] + 512 [t same x]
ways    = 36 h(z) + 6 h(y) + h(x)   # h: the candidate it was copied from; 4: it was coded; 5: it is not there
F(n), L(n) = 1 + first, last symbol of neighbour n, 0 if it is not there
```

Candidates 0 to 3 are t, z, y, x; one that is not there is passed over, and so is z if it is the same as t, y if it is
the same as z or t, x if it is the same as z, y or t. For each c of the others a bit, mixed of H(1, c, pattern),
H(2, c, ways, pattern mod 16), H(3, c, F(z), L(z)), H(4, c, F(y), F(x), F(z)), H(5, c, F(t), F(z)), H(6, c, ways,
pattern), weights c: 1 if the sample is the same as it; then the sample is done. Otherwise its symbols follow, plane
by plane. For plane p of size S, let z, y, x, zy, zx, t be 1 + the neighbour's symbol in that plane, 0 if it is not
there, zz that of the neighbour of z along z, yy of that of y along y; one, two be 1 + this sample's symbols in planes
p - 1 and p - 2, 0 if there is none; w the number of binary digits of S - 1, B = H(7, p), and, "or" being the first of
its terms that is not 0,

```text
seed 0 .. 7:  B;  H(B,1,z);  H(B,2,y);  H(B,3,x);  H(B,4,z,y,x);  H(B,5, p ? one : z, p ? two : x);  H(B,6,t,z);
              H(B,7,z,one,two)
first = z or y or x or t;   third = y or x or t;   count = [z] + [y] + [x]
guess 8:   first
guess 9:   z + y - zy if z, y are and neighbour zy is there, else first
guess 10:  z + x - zx if z, x are and neighbour zx is there, else third or first
guess 11:  t or (z + y + x) // count, 0 if count is
guess 12:  2 z - zz if z, zz are, else first
guess 13:  2 y - yy if y, yy are, else third
spread = digits of |z - y|, |z - x| or |y - x|, the first whose both terms are; at most 15, else 0
seed k of 8 .. 13 = H(B, k, k odd ? spread : count, [guess k > 0]);   then guess k = guess k - 1, within 0 .. S - 1
node = 1
for left = w - 1 .. 0:
    ahead(k) = node - 2^(w - 1 - left) - (guess k >> (left + 1)), within -2 .. 2
    agree    = how many of the six ahead(k) are 0
    bit, mixed of H(seed k, node), k = 0 .. 7, and of
        H(seed k, ((ahead(k) + 2) 8 + ((4 guess k >> left) mod 8)) 32 + left), k = 8 .. 13,
        weights 4 + 7 (20 p + left) + agree
    node = 2 node + bit
symbol = node - 2^w, below S
```
"""
