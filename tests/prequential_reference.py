"""The prequential code once more, as a decoder would run it: plain Python that knows only what was told before.

Contexts are dictionary keys here, without hashing, and voxels a dictionary that grows as they are told; bricks' flags
are paid one after the other by the running Krichevsky-Trofimov chance instead of the closed form.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from touchfield.measure.field_symbols import FieldSymbols

CORNER = [d for d in itertools.product((-1, 0), repeat=3) if any(d)]
AXES = [(0, 0, -1), (0, -1, 0), (-1, 0, 0)]
HALF = [d for d in itertools.product((-1, 0, 1), repeat=3) if d < (0, 0, 0)]
SIX = [(0, 0, 0), (0, 0, 1), (0, 0, -1), (0, 1, 0), (0, -1, 0), (1, 0, 0), (-1, 0, 0)]
Place = tuple[int, int, int]


class ReferenceCode:
    """Bits of frames, frame by frame."""

    def __init__(self, alphabet: int, split: int) -> None:
        self.radices = (-(-(alphabet - 1) // split), split)
        self.learnt: dict[object, tuple[float, int]] = {}
        self.plain: dict[object, list[float]] = {}
        self.weights: dict[object, list[float]] = {}
        self.log_mixed = self.log_plain = self.paid = 0.0
        self.flag_counts: dict[object, list[float]] = {}
        self.flag_logs = [0.0] * 6
        self.flags_before: set[Place] = set()
        self.old: dict[Place, int] = {}

    def frame(self, field: FieldSymbols) -> float:
        """The bits of one frame."""
        dense = field.to_dense()
        voxels = {tuple(map(int, p)): int(dense[tuple(p)]) for p in np.argwhere(dense)}
        held = {(x // 8, y // 8, z // 8) for x, y, z in voxels}
        bits = sum(self.flag(b, held) for b in itertools.product(*map(range, field.grid.brick_shape)))
        self.flags_before = held
        self.now: dict[Place, int] = {}
        for brick in sorted(held):
            for local in itertools.product(range(8), repeat=3):
                place = tuple(8 * b + i for b, i in zip(brick, local, strict=True))
                if all(p < n for p, n in zip(place, field.grid.shape, strict=True)):
                    bits += self.voxel(place, voxels.get(place, 0))
        self.old = self.now
        return bits

    def flag(self, brick: Place, held: set[Place]) -> float:
        def near(d: Place) -> bool:
            return tuple(b + i for b, i in zip(brick, d, strict=True)) in held

        sets = [(), tuple(map(near, AXES)), tuple(map(near, CORNER))]
        sets += [(*s, "before", brick in self.flags_before) for s in sets]
        bit = int(brick in held)
        start = self.mean_log(self.flag_logs)
        for m, s in enumerate(sets):
            counts = self.flag_counts.setdefault((m, s), [0.5, 0.5])
            self.flag_logs[m] += math.log2(counts[bit] / sum(counts))
            counts[bit] += 1
        return start - self.mean_log(self.flag_logs)

    @staticmethod
    def mean_log(logs: list[float]) -> float:
        top = max(logs)
        return top + math.log2(sum(2 ** (g - top) for g in logs) / len(logs))

    def voxel(self, place: Place, symbol: int) -> float:
        def at(known: dict[Place, int], x: int, y: int, z: int) -> int:
            return known.get((place[0] + x, place[1] + y, place[2] + z), 0)

        a, b, c = (at(self.now, *d) for d in AXES)
        p = at(self.old, 0, 0, 0)
        near = tuple(at(self.now, *d) > 0 for d in HALF)
        far = tuple(at(self.now, *(2 * i for i in d)) > 0 for d in AXES)
        then = tuple(at(self.old, *d) > 0 for d in SIX)
        three = (a > 0, b > 0, c > 0)
        first = {s: self.digits(s)[0] for s in (a, b, c, p)}
        keys = [
            (near, far), (then, three), (first[a], first[b], first[c]), (first[a], first[p], first[c]),
            (first[b], self.digits(at(self.now, 0, -2, 0))[0]), (first[a], self.digits(at(self.now, 0, 0, -2))[0]),
            (near[:-4], then),
        ]  # fmt: skip
        bits = self.decide(int(symbol > 0), "support", keys, ("support", three, p > 0))
        if symbol:
            own = 0
            for d in range(2):
                bits += self.digit(d, symbol, own, (a, b, c, p), at)
                own = self.digits(symbol)[d]
        self.now[place] = symbol
        return bits

    def digits(self, symbol: int) -> tuple[int, int]:
        return (0, 0) if symbol == 0 else tuple(i + 1 for i in divmod(symbol - 1, self.radices[1]))

    def digit(self, d: int, symbol: int, own: int, around: tuple[int, int, int, int], at: object) -> float:
        a, b, c, p = around
        da, db, dc, dp = (self.digits(s)[d] for s in around)
        if d == 0:
            ab, ac, bc = (self.digits(at(self.now, *e))[0] for e in ((0, -1, -1), (-1, 0, -1), (-1, -1, 0)))
            guess = (2 * (da + db + dc) - ab - ac - bc, a > 0, b > 0, c > 0)
        else:
            found = [(abs(self.digits(s)[0] - own), n, s) for n, s in enumerate((b, c, a, p)) if s > 0]
            guess = (self.digits(min(found)[2])[1], min(min(found)[0], 3)) if found else (0, 0)
        keys = [(da,), (db,), (dc,), (da, db, dc), (dp, own), guess, (own, db, dc)]
        bits, low, depth = 0.0, 0, (self.radices[d] - 1).bit_length()
        for level in range(depth):
            half = 1 << (depth - 1 - level)
            if low + half >= self.radices[d]:
                continue
            bit = int(self.digits(symbol)[d] - 1 >= low + half)
            bits += self.decide(bit, (d, level, low), keys, (d, level, c > 0))
            low += half * bit
        return bits

    def decide(self, bit: int, node: object, keys: list[tuple[object, ...]], chosen: object) -> float:
        counts = self.plain.setdefault(node, [0.5, 0.5])
        chances = [self.learnt.get((node, i, k), (0.5, 0)) for i, k in enumerate(keys)]
        inputs = [math.log(q / (1 - q)) for q, _ in [*chances, (counts[1] / sum(counts), 0)]]
        weights = self.weights.setdefault(chosen, [0.25] * 8)
        mixed = 1 / (1 + math.exp(-sum(w * s for w, s in zip(weights, inputs, strict=True))))
        mixed = min(max(mixed, 2**-20), 1 - 2**-20)
        for i, s in enumerate(inputs):
            weights[i] += 0.01 * (bit - mixed) * s
        for i, k in enumerate(keys):
            q, n = chances[i]
            self.learnt[node, i, k] = (q + (bit - q) / (n + 1.5), min(n + 1, 1023))
        self.log_mixed += math.log2(mixed if bit else 1 - mixed)
        self.log_plain += math.log2(counts[bit] / sum(counts))
        counts[bit] += 1
        paid = -self.mean_log([self.log_mixed, self.log_plain])
        bits, self.paid = paid - self.paid, paid
        return bits
