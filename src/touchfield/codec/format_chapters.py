"""The chapters of docs/format.md that complete the description of coder "paper", down to the last bit.

Constants are taken from the code that uses them, tables of neighbours stand here; conformance/reference_decoder.py
follows these pages, and tests/test_reference_decoder.py holds both against the package. Only the writer of the
document imports this module, as it needs the compiled kernels for their constants.
"""

from __future__ import annotations

import zlib
from typing import Any, Final

import numpy as np

from touchfield.codec import huffman, runs, support
from touchfield.codec.directions import LARGEST_FREQUENCY, Codebook, codebook_names
from touchfield.codec.kernels import mixer
from touchfield.codec.kernels import support as kernels
from touchfield.codec.paper_format import MOST_NEWTONS
from touchfield.codec.varint import VARINT_LIMIT
from touchfield.perception import weber

__all__ = [
    "BEFORE_OFFSETS",
    "CHAPTER",
    "CHAPTERS",
    "FIRST_OFFSETS",
    "SECOND_OFFSETS",
    "WEIGHT_OFFSETS",
    "table_checks",
]

Offsets = tuple[tuple[int, int, int], ...]

FIRST_OFFSETS: Final[Offsets] = (
    (-1, 0, 0), (-1, 0, -1), (0, -1, 1), (0, -1, 0), (0, -1, -1), (-1, -1, 0),
    (-2, 0, 2), (-1, 1, 0), (-1, 1, -1), (-2, -2, 0), (0, -2, 1), (0, 0, 1),
)  # fmt: skip
"""Neighbours in the first context of a sample, bit 0 first; of the frame itself."""

SECOND_OFFSETS: Final[Offsets] = (
    (-1, 0, 1), (-1, 0, 0), (-1, 0, -1), (-1, 0, -2), (0, -1, 1), (0, -1, 0), (0, -1, -1), (0, -1, -2),
    (0, 0, 4), (0, 0, 3), (0, 0, 2), (0, 0, 1), (-2, 0, 0), (0, -2, 0),
)  # fmt: skip
"""Neighbours in the second context where no previous support is given; of the frame itself."""

BEFORE_OFFSETS: Final[Offsets] = (
    (0, 0, 1), (0, 0, 0), (0, 0, -1), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0)
)  # fmt: skip
"""Neighbours in the second context where one is given; of the previous support."""

WEIGHT_OFFSETS: Final[Offsets] = ((-1, 0, 0), (0, -1, 0), (0, 0, 1))
"""Neighbours that choose the weights, and above `BEFORE_OFFSETS` in the second context; of the frame itself."""


def _listed(offsets: Offsets) -> str:
    return " ".join(f"({x},{y},{z})" for x, y, z in offsets)


def _crc(array: np.ndarray[Any, Any], code: str) -> str:
    return f"{zlib.crc32(array.astype(code).tobytes()):08x}"


def table_checks() -> dict[str, str]:
    """CRC-32 of each table that a decoder makes, in the form that the document names."""
    tables = {
        "squash": _crc(mixer.SQUASH, "<i4"),
        "stretch": _crc(mixer.STRETCH, "<i4"),
        "rates": _crc(mixer.RATES, "<i4"),
    }
    return tables | {name: _crc(Codebook.get(name).vertices_float32, "<f4") for name in codebook_names()}


# -- amplitude levels -------------------------------------------------------------------------------------

_FINEST_GRAIN: Final = -40
_NARROWING_POWER: Final = round(np.log2(weber._NARROWING))

LEVELS: Final = f"""\
### Amplitude levels

The first byte of this chunk is the kind of table; its parameters fill the rest.

| kind | parameters | levels |
|---|---|---|
| 0: levels | u16 n - 1; n × f32 | these: not negative, strictly ascending |
| 1: Weber ladder | f64 k, f64 F, u16 N, u8 criterion | N + 1 levels, below |
| 2: uniform | f64 step, u32 n | level i is step × i, a product in f64, rounded to f32 |

Bounds: k from {weber._SMALLEST_K:g} to less than 1; F and step from {weber._SMALLEST_FORCE_N:g} to
{weber._LARGEST_FORCE_N:g} newtons; N and n 1 or more; criterion 0 or 1. Of whatever kind, there are at most
{runs.MAX_LEVELS} levels, and the last is at most {MOST_NEWTONS:g} newtons.

The ladder in f64, each operation rounded to nearest, ties to even, in the order written:

```text
kappa   = (criterion == 0 ? k : k / (2 + k)) - 2^{_NARROWING_POWER}
rho     = (1 + kappa) / (1 - kappa)
t[0]    = F,  t[i+1] = t[i] * rho
level 0 = 0,  level i+1 = (1 + kappa) * t[i], rounded to f32       i = 0 .. N-1
```
"""

# -- codes ------------------------------------------------------------------------------------------------

CODES: Final = f"""\
### Huffman lengths

A chunk of code lengths tells for each symbol of an alphabet, from symbol 0 on, how many bits its code has, 1 to
{huffman.MAX_CODE_BITS}, or that it is absent. The alphabet of the amplitude stream has N + {runs.RUN_SYMBOLS} symbols
for N levels, that of the directions one symbol for each vertex of the codebook. The chunk is read as half bytes, the
high half of a byte first:

| half byte | what |
|---|---|
| 0 to 8 | length = last length - 4 + this; the "last length" before the first is {huffman._FIRST_LAST} |
| {huffman._EXPLICIT} | length in the two half bytes that follow, the high one first |
| {huffman._ABSENT} | this symbol is absent |
| {huffman._ABSENT_RUN} | absent symbols: 2 more than the number that follows |

That number is in groups of three bits, the lowest first, one to six of them; a group that another follows has 8 added
to its half byte. Absent symbols leave the last length as it is. When all symbols have been told, at most one half
byte is left, and it is zero.

Codes are canonical: sorted by length, and by symbol within a length, the first code is all zeros, and each
next one is (the one before + 1), with as many zeros behind it as it is longer. The lengths make a complete code (the
sum of 2^-length is 1), but for two cases: no symbol at all, or one symbol alone, whose length is 1 and whose
code is the bit 0. A code is written with its highest bit first, and so are the raw bits behind a run symbol.

### The two streams

The amplitude stream is decoded until it has told of every supported sample of the frame; a run that reaches
beyond the last one is an error. The symbols of runs are N + j, j = 0 to {runs.RUN_SYMBOLS - 1}. The direction stream
has one code for each sent sample, in scan order. Both must fill their bit chunks exactly. A support of no samples has
two streams of no bits.
"""

# -- the support ------------------------------------------------------------------------------------------

_FRESH: Final = mixer.Coder(np.zeros(0, np.uint8), True, (1, 1), 1)
_HALF: Final = mixer._HALF_DOMAIN
_WIDTH: Final = mixer._MASK.bit_length()

SUPPORT: Final = f"""\
### The support

A brick is 8 × 8 × 8 samples; brick (X, Y, Z) holds samples 8 X to 8 X + 7 along x, and so on. The grid has
bx × by × bz bricks, b = ceil(samples / 8); the last along an axis may reach beyond the grid. The *samples
of a brick* are those within the grid. A brick of a support has at least one set sample; it is *full* if
all its samples are set, and *mixed* otherwise. The *previous support* is, in a frame of kind 1, that of the last
frame before it in the segment whose kind is not 2; in the other kinds there is none.

The bytes:

1. varint n, the number of bricks, at most bx by bz, and at most {support.BRICKS_PER_BYTE} for each byte of the chunk.
   If n is 0, nothing follows.
2. If bx by bz > {support._CELLS_PER_BRICK} n + {support._CELLS_FREE}, a *list*: for each brick a varint
   (gap × 2 + full). The key of a brick is (X by + Y) bz + Z; keys ascend and lie below bx by bz;
   gap is the key, less the key before, less 1, and for the first brick the key itself.
3. The arithmetic code, to the end: first, where there is no list, the states of bricks; then the samples of the mixed
   bricks. Between the two the models begin anew, while the arithmetic decoder goes on.
4. Zeros, until the chunk has ceil(n / {support.BRICKS_PER_BYTE}) bytes.

**Arithmetic decoder.** Whole numbers; `low` = 0, `high` = 2^{_WIDTH} - 1, `value` = the first six bytes of the code,
the first one highest; behind the end of the chunk zeros are read. A bit whose chance to be 1 is p / 65536:

```text
span   = high - low
middle = low + (span >> 16) * p + (((span & 65535) * p) >> 16)
bit    = value <= middle ? 1 : 0
if bit: high = middle     else: low = middle + 1
while low >> {mixer._TOP} == high >> {mixer._TOP}:      # the top bytes agree
    value = (value << 8) mod 2^{_WIDTH} + next byte
    low   = (low << 8) mod 2^{_WIDTH}
    high  = (high << 8) mod 2^{_WIDTH} + 255
    used  = used + 1
```

At the end, `used` bytes of the code have been used up, and the fewest bytes follow that name a number in the
interval: for c = 0, 1, 2, ... let e be the smallest multiple of 2^({_WIDTH} - 8 c) that is not below `low`; the first
c with e <= `high` is taken, and the c highest of the six bytes of e follow. A reader checks them; after them come the
zeros of step 4, and nothing else.

**Tables.** `>>` is the shift that rounds down, for negative numbers too, and `//` division that rounds down.

```text
one = 2^96;  step = term = one
for n = 1 .. 19:  term = term // (256 n);  step = step + term          # e^(1/256)
power = one
for x = 0 .. {_HALF - 1}:
    s[x]  = (65536 power + (one + power) // 2) // (one + power)
    power = (power step) >> 96
s[-x] = 65536 - s[x] for x = 1 .. {_HALF - 1};   s[-{_HALF}] = s[-{_HALF - 1}]
squash[x]  = s[x], but at least {mixer.FLOOR} and at most {65536 - mixer.FLOOR},   x = -{_HALF} .. {_HALF - 1}
stretch[c] = the smallest x for which s[x] >= 16 c + 8,   c = 0 .. 4095
rate[v]    = 2^20 // (2 v + 3),   v = 0 .. {mixer._RATE_LIMIT}
```

**Models.** Two tables of contexts, each with a chance (of 2^22, at first {_FRESH.chances[0]}) and a count of
visits v (at first 0), and sets of two weights (at first {_FRESH.weights[0, 0]} each). A context *learns* a bit:

```text
chance = chance + ((((bit ? {mixer.ALL} : 0) - chance) * rate[v]) >> 19)
v      = min(v + 1, {mixer._RATE_LIMIT})
```

A *mixed* bit has a context in the first table (chance A), one in the second (chance B), and a set of weights
(wa, wb):

```text
a = stretch[A >> 10];  b = stretch[B >> 10]
x = (wa a + wb b) >> 16, but at least -{_HALF} and at most {_HALF - 1}
p = squash[x];  decode the bit with p
error = 65536 bit - p
wa = wa + ((a error + 8192) >> 14);  wb = wb + ((b error + 8192) >> 14)
both contexts learn the bit
```

**States of bricks.** First table {kernels.CELL_CONTEXTS[0]} contexts, second {kernels.CELL_CONTEXTS[1]},
{kernels.CELL_SETS} sets of weights. Bricks come with X slowest, ascending, then Y, ascending, then Z, *descending*.
S(X, Y, Z) is 0 for a brick that is absent, not yet decoded, or outside the grid, 1 for a mixed and 2 for a full one;
P is the same in the previous support, 0 where there is none. For each brick, until n have been found:

```text
near = 9 S(X,Y,Z+1) + 3 S(X,Y-1,Z) + S(X-1,Y,Z)
wide = [S(X,Y-1,Z-1) > 0] + 2 [S(X-1,Y,Z-1) > 0] + 4 [S(X-1,Y+1,Z) > 0] + 8 [S(X-1,Y-1,Z) > 0]
c    = 2 (3 near + P(X,Y,Z))
present: a mixed bit in contexts c and 16 c + wide, weights 2 P(X,Y,Z)
full, if present: a mixed bit in contexts c + 1 and 16 (c + 1) + wide, weights 2 P(X,Y,Z) + 1
```

Bricks that come after the n-th are absent, and have no bits; n must be found.

**Samples.** First table {kernels.SAMPLE_CONTEXTS[False][0]} contexts, {kernels.SAMPLE_SETS} sets of weights; second
table {kernels.SAMPLE_CONTEXTS[False][1]} contexts where the previous support has no brick or there is none, otherwise
{kernels.SAMPLE_CONTEXTS[True][1]}. Mixed bricks come in the order of the states of bricks (X slowest and ascending,
then Y ascending, then Z descending), and the samples of each in the same order (x slowest and ascending, then y
ascending, then z descending). At any time the *known* samples are all samples of full bricks, wherever they are, and
the set samples decoded so far. A context is the number whose bit i, bit 0 first, tells whether the sample at the i-th
of these distances (along x, y, z) is known, or is in the previous support:

| what | of | distances |
|---|---|---|
| first | known | {_listed(FIRST_OFFSETS)} |
| weights | known | {_listed(WEIGHT_OFFSETS)} |
| second, no previous bricks | known | {_listed(SECOND_OFFSETS)} |
| second, with previous bricks | previous support | {_listed(BEFORE_OFFSETS)} |
| | known, as bits {len(BEFORE_OFFSETS)} to {len(BEFORE_OFFSETS) + 2} | {_listed(WEIGHT_OFFSETS)} |

If the first context has v >= {kernels._SURE_VISITS}, and a chance below {kernels._SURE} or above
{mixer.ALL - kernels._SURE}, it decides alone: p = chance >> 6, but at least {mixer.FLOOR} and at most
{65536 - mixer.FLOOR}; the bit is decoded with p, and the first context learns it. Otherwise it is a mixed bit. A
mixed brick that turns out to be empty or full is an error.
"""

# -- directions and synthesis -----------------------------------------------------------------------------


def _directions() -> str:
    rows = [
        f"| {name} | {len(Codebook.get(name))} | `{check}` |"
        for name, check in table_checks().items()
        if name in codebook_names()
    ]
    return f"""\
### Direction codebooks

| name | vertices |
|---|---|
| `octaF`, F = 1 to {LARGEST_FREQUENCY["octa"]} | 4^(F+1) + 2: an octahedron, split F times |
| `icoF`, F = 1 to {LARGEST_FREQUENCY["ico"]} | 10 F² + 2: an icosahedron, each edge in F parts of equal angle |
| `icoF-flat`, F = 3 to {LARGEST_FREQUENCY["ico"]} | the same, each edge in F parts of equal length |

- **octaF.** Begin with the eight triangles whose corners are (±1, 0, 0), (0, ±1, 0), (0, 0, ±1). F times, each
  triangle (a, b, c) becomes (a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca), where ab is a + b divided by its
  length, and so on. The vertices are the corners of all triangles.
- **icoF.** The twelve corners are (0, ±1, ±g), (±g, 0, ±1), (±1, ±g, 0) divided by their length,
  g = (1 + √5) / 2; the 20 faces are the sets of three corners whose dot products are 1/√5 in pairs. For each
  face (A, B, C) and all i + j + k = F, i, j, k = 0 to F, there is a vertex w(i) A + w(j) B + w(k) C divided by its
  length, with w(i) = sin(i arctan(2) / F); and for **-flat** w(i) = i / F.

Each coordinate is rounded to the nearest multiple of 2^{_FINEST_GRAIN}; vertices that are then equal are one.
They are sorted by x, then y, then z, ascending: the place of a vertex is its index. Then each coordinate is
rounded to f32, to nearest, ties to even: these are the numbers that the decoder multiplies. No exact coordinate lies
nearer than 2^-54 to the middle of two multiples of 2^{_FINEST_GRAIN}, so that 64 bits of precision always give
these tables. Binary64 just gives them too, in the two decoders that there are; the CRC-32 below tells.

CRC-32 of the vertices in their order, x, y, z of each as little-endian f32:

| name | vertices | CRC-32 |
|---|---|---|
{chr(10).join(rows)}

CRC-32 of the tables of the support code, in ascending order of their argument, each number as little-endian i32:
squash `{table_checks()["squash"]}`, stretch `{table_checks()["stretch"]}`, rate `{table_checks()["rates"]}`.
"""


SYNTHESIS: Final = """\
### Synthesis

`level` is an f32 of the amplitude levels, `vertex` three f32 of the codebook; each product and each sum is rounded to
f32 by itself (no fused multiply-add). In a frame, for each supported sample in scan order:

```text
kind 0 or 2, sent:  last = level * vertex;  force = last
kind 0 or 2, held:  force = last                        # (0, 0, 0) until something is sent in this frame
kind 1, sent:       force = before + level * vertex     # before: the decoded force of the previous frame
kind 1, held:       force = before                      # at the same sample, (0, 0, 0) where it has none
```

All samples that are not supported have force zero, in kind 1 too, whatever they had before. In kind 2 these forces
are the differences: the frame is, at every sample, the decoded previous frame + difference, and what the previous
frame had elsewhere stays. "The previous frame" is the one before it in the segment, of whatever kind, as it was
decoded. A supported sample may have force zero; whether a zero is written as +0 or -0 has no meaning.

conformance/v0 has files and the forces they decode to; conformance/reference_decoder.py is a short decoder that
follows this document.
"""

CODES_INTRODUCTION: Final = f"""\
### Numbers in a body

A varint lies below 2^{VARINT_LIMIT.bit_length() - 1}, eight bytes at most, and is in its shortest form: its last byte
is not zero, unless it is its only one. The parts fill the body exactly, and a chunk is filled by what is in it. A
table set of which no frame is in need may be there; a frame whose set is not there is an error.
"""

CHAPTERS: Final = (CODES_INTRODUCTION, LEVELS, CODES, SUPPORT, _directions(), SYNTHESIS)

CHAPTER: Final = "\n".join(CHAPTERS)
"""What `touchfield.container.format_document` prints behind the chapter of `touchfield.codec.paper_format`."""
