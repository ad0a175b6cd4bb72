"""What the bytes of the post filter are: the chapter of the file format."""

from __future__ import annotations

from typing import Final

from touchfield.codec.kernels.touch_lattice import LIMIT

__all__ = ["POST_FILTER_CHAPTER"]

POST_FILTER_CHAPTER: Final = f"""\
### The filter after a frame

The chunk of a frame's filter is one term after another, two bytes each, in strictly ascending order of their first
byte: u8 `number`, 0 to 168, and u8 `code`. The weight of a term is

```text
weight = (8 + (code & 7)) << ((code >> 3) & 15),   its negative if code & 128;   in 1/2^14
```

`number` = 56 `kind` + `group`. Kind 0 is of clipped differences, 1 of differences, 2 of what is outside; number 168,
the only one of kind 3, is of the force itself. A group is a set of the 26 offsets (x, y, z) to the neighbours of a
sample, -1, 0 or 1 each, which count from 0 in ascending order (x slowest), (0, 0, 0) left out:

| group g | offsets |
|---|---|
| 0 to 25 | the one that counts g |
| 26 to 38 | those that count g - 26 and 51 - g, its opposite |
| 39 to 45 | those with 4 abs(x) + 2 abs(y) + abs(z) = g - 38 |
| 46 to 48 | those with abs(x) + abs(y) + abs(z) = g - 45 |
| 49 | all |
| 50 to 55 | those with x = -1, x = 1, y = -1, y = 1, z = -1, z = 1, in this order |

The weights w0, w1, w2 of an offset, one for each of the kinds 0, 1 and 2, are the sums of those of the terms of that
kind whose group holds it; w3 is the weight of number 168, else 0. Let t be the lattice's floor >> 1. For each sample
with a force f, and each component of it:

```text
s = 8192 + w3 f
for each offset:  the neighbour has a force, g:  d = g - f;   s = s + w1 d + w0 max(-t, min(d, t))
                  it has none:                               s = s - w2 f
filtered = f + (s >> 14), within ±{LIMIT}
```

A sample whose three components would all be 0 keeps f. All of it reads the frame before the filter. The filtered
frame is what is shown (exceptions replace its forces in newtons); the next frame is predicted from the frame as it
was before the filter.
"""
