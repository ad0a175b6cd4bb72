"""The pass over the voxels of a frame of coder `touch`, for the second decoder: support and prediction.

Places, vectors and axes are those of the scan; vectors are in units.
"""

from __future__ import annotations

from touch_bits import Bits, Models, Place, ended, moved
from touch_residual import Cell, Lattice, Residual, clip, dot, length_of, limited, minus

__all__ = ["Frame", "Voxel"]

SATURATED, FEATURES = (1 << 16) - (1 << 10), 13
BEFORE = ((-1, 0, 0), (0, -1, 0), (0, 0, -1))


class Voxel:
    """What is gathered of a voxel before its force is told."""

    def __init__(self, frame: Frame, at: Place, known: bool) -> None:
        self.at, self.cells, self.old = at, frame.cells, frame.old
        self.faces = [frame.cells.get(moved(at, step)) for step in BEFORE]
        self.near = sum((cell is not None) << n for n, cell in enumerate(self.faces))
        self.count = self.near.bit_count()
        self.then = self.reference_here() if known else 0

    def held(self, *step: int) -> int:
        return int((self.at[0] + step[0], self.at[1] + step[1], self.at[2] + step[2]) in self.cells)

    def was(self, axis: int, step: int) -> int:
        x, y, z = (n + step * (c == axis) for c, n in enumerate(self.at))
        return int((x, y, z) in self.old)

    def reference_here(self) -> int:
        about = sum(self.was(axis, step) for axis in range(3) for step in (-1, 1))
        return 4 + (about >= 5) + (about == 6) if self.at in self.old else 1 + (about >= 1) + (about >= 3)


class Frame:
    """A frame while it is decoded."""

    def __init__(
        self, code: bytes, models: Models, weights: dict[int, list[int]], lattice: Lattice, slope: Place, axis: int
    ) -> None:
        self.bits, self.lattice, self.slope, self.axis = Bits(code, models), lattice, slope, axis
        self.weights = weights
        self.known: set[Place] = set()
        self.old: dict[Place, Place] = {}
        self.cells: dict[Place, Cell] = {}
        self.state, self.last = 0, (0, 0, 0)

    def end(self, count: int) -> None:
        ended(self.bits, count)

    def brick(self, brick: Place, inside: list[Place]) -> None:
        """A brick, whose samples within the grid are `inside`, in order."""
        known, state = brick in self.known, 0
        if known:
            context = self.state
            state = 2 if self.bits.code(("brick", context)) else self.bits.code(("brick", 4 + context))
            self.state = state
        if state == 2:
            for at in inside:
                if at in self.old:
                    self.store(at, self.old[at], 0, 0, 0)
            return
        blocks = self.blocks(brick, known)
        for at in inside:
            if blocks >> ((at[0] >> 2 & 1) * 4 + (at[1] >> 2 & 1) * 2 + (at[2] >> 2 & 1)) & 1:
                voxel = Voxel(self, at, known)
                if self.support(voxel):
                    self.voxel(voxel, state == 1)

    def store(self, at: Place, v: Place, along: int, across: int, fine: int) -> None:
        a = length_of(v)
        inverse = (1 << 28) // a
        x, y, z = (a - ((c * inverse >> 14) * s >> 14) for c, s in zip(v, self.slope))
        self.cells[at] = Cell(v, a, (x, y, z), along, across, fine)

    # -- support ------------------------------------------------------------------------------------------

    def blocks(self, brick: Place, known: bool) -> int:
        """Which sub-blocks of 4 x 4 x 4 voxels hold a force."""
        out = 0
        for n in range(8):
            first = (8 * brick[0] + (n & 4), 8 * brick[1] + 2 * (n & 2), 8 * brick[2] + 4 * (n & 1))
            sides = 0
            for c in range(3):
                bit = 4 >> c
                if n & bit:
                    side = out >> (n - bit) & 1
                else:
                    spans = [range(f - 1, f) if d == c else range(f, f + 4) for d, f in enumerate(first)]
                    side = any((x, y, z) in self.cells for x in spans[0] for y in spans[1] for z in spans[2])
                sides = sides << 1 | side
            then = 0
            if known:
                x, y, z = (range(f, f + 4) for f in first)
                then = 1 + any((i, j, k) in self.old for i in x for j in y for k in z)
            out |= self.bits.code(("block", then << 3 | sides)) << n
        return out

    def support(self, v: Voxel) -> int:
        """Whether a voxel holds a force."""
        held = v.held
        mask = v.near | held(-1, 1, 0) << 3 | held(-1, 0, 1) << 4 | held(0, -1, 1) << 5
        wide = held(-1, -1, 0) | held(-1, 0, -1) << 1 | held(0, -1, -1) << 2 | held(-2, 0, 0) << 3
        behind, then, own = held(0, 0, -2), v.then, int(v.then >= 4)
        ahead = [cell.ahead[n] if cell else None for n, cell in enumerate(v.faces)]
        bins = [likely(a) if a is not None else 0 for a in ahead]
        bin_ = likely(sum(a for a in ahead if a is not None) // v.count) if v.count else wide
        patch = sum(held(-1, i, j) for i in (-1, 0, 1) for j in (-1, 0, 1))
        row = held(0, -1, -1) + held(0, -1, 0) + held(0, -1, 1)
        around = 0
        if then:
            around = own
            for axis in range(3):
                around = around << 2 | v.was(axis, -1) << 1 | v.was(axis, 1)
        contexts = (
            (bin_ << 6 | mask) << 3 | then,
            ((wide | held(0, -2, 0) << 4 | behind << 5) << 6 | mask) << 3 | then,
            ((bins[0] << 4 | bins[1] >> 1) << 4 | bins[2] >> 1) << 1 | own,
            (around << 3 | v.near) << 2 | bin_ >> 3,
            (((patch << 2 | row) << 1 | behind) << 1 | v.near >> 2) << 3 | bin_ >> 2,
            (bins[0] << 6 | mask) << 1 | own,
        )
        return self.mix("held", 0, contexts, v.count << 3 | then)

    def mix(self, name: str, c: int, contexts: tuple[int, ...], chosen: int) -> int:
        """A bit by context n of table (name, n, c), for each n."""
        return self.bits.mix([(name, n, c, context) for n, context in enumerate(contexts)], (name, c, chosen))

    # -- prediction ---------------------------------------------------------------------------------------

    def chain(self, v: Voxel, axis: int) -> Place:
        """The force law followed from the neighbour before along an axis, which holds a force."""
        cell = v.faces[axis]
        assert cell is not None
        a = cell.length
        length = cell.ahead[axis] if a < SATURATED else at_top(v, axis, a)
        length = max(length, a >> 3, self.lattice.floor >> 1, 1)
        ratio = min((length << 14) // a, 1 << 17)
        x, y, z = (c * ratio + 8192 >> 14 for c in cell.vector)
        return limited(x, y, z)

    def follow(self, v: Voxel, trusted: bool) -> tuple[Place | None, int]:
        """What is expected without correction, and whence: the axis, 3 the reference, -1 nothing."""
        if trusted and v.at in self.old:
            cell, before = v.faces[0], self.old.get(moved(v.at, BEFORE[0]))
            off = (0, 0, 0) if cell is None or before is None else minus(cell.vector, before)
            if cell is None or dot(off, off) <= self.lattice.step(cell.length) ** 2:
                return self.old[v.at], 3
        if self.axis < 3:
            for axis in (self.axis, 0, 1, 2):
                if v.faces[axis]:
                    return self.chain(v, axis), axis
        return None, -1

    def first(self, v: Voxel) -> Place:
        """The base where no neighbour across a face holds a force."""
        if v.at in self.old:
            return self.old[v.at]
        for step in ((-1, -1, 0), (-1, 1, 0), (-1, 0, -1), (-1, 0, 1), (0, -1, -1), (0, -1, 1)):
            if moved(v.at, step) in self.cells:
                return self.cells[moved(v.at, step)].vector
        return self.last

    def mean(self, v: Voxel) -> tuple[Place, int]:
        """The base of neighbours, and the step there."""
        cells = [(cell, cell.ahead[n]) for n, cell in enumerate(v.faces) if cell]
        total = sum(cell.length for cell, _ in cells)
        expected = sum(max(ahead, cell.length >> 3) for cell, ahead in cells)
        scale = min((expected << 16) // (total * v.count), 1 << 17)
        x, y, z = (sum(cell.vector[k] for cell, _ in cells) * scale + 32768 >> 16 for k in range(3))
        return (x, y, z), self.lattice.step(expected // v.count)

    def features(self, v: Voxel, base: Place, inverse: int) -> list[Place]:
        """Differences of neighbours, 1/256 steps."""
        cells, at, nothing = self.cells, v.at, (0, 0, 0)

        def vector(*step: int) -> Place | None:
            cell = cells.get((at[0] + step[0], at[1] + step[1], at[2] + step[2]))
            return cell and cell.vector

        deep, up, left = vector(-1, 0, 0), vector(0, -1, 0), vector(0, 0, -1)
        made = []
        for one in (deep, up, left, vector(-1, 1, 0), vector(-1, 0, 1), vector(0, -1, 1)):
            made.append(minus(one, base) if one else nothing)
        for one, other in (
            (deep, vector(-2, 0, 0)), (up, vector(-1, -1, 0)), (left, vector(-1, 0, -1)),
            (left, vector(0, -1, -1)), (up, vector(0, -1, -1)),
        ):  # fmt: skip
            made.append(minus(one, other) if one and other else nothing)
        was, changes = self.old.get(at), []
        made.append(minus(was, base) if was else nothing)
        for step, one in zip(BEFORE, (deep, up, left)):
            before = self.old.get(moved(at, step))
            if was and one and before:
                changes.append(minus(one, before))
        out = [scaled(f, inverse) for f in made]
        total = (sum(c[0] for c in changes), sum(c[1] for c in changes), sum(c[2] for c in changes))
        return [*out, scaled(total, inverse // max(1, len(changes)))]

    def voxel(self, v: Voxel, trusted: bool) -> None:
        """The force of a voxel that holds one."""
        kind, features, inverse, step = -1, [], 0, 0
        if v.near:
            base, step = self.mean(v)
            inverse = (1 << 32) // step
            features = self.features(v, base, inverse)
            kind = v.near | (v.at in self.old) << 3
            weights = self.weights.setdefault(kind, [0] * FEATURES)
            sums = [sum(w * f[k] for w, f in zip(weights, features)) for k in range(3)]
            x, y, z = (b + ((s >> 16) * step >> 8) for b, s in zip(base, sums))
            blend = limited(x, y, z)
        else:
            base = blend = self.first(v)
        expected, source = self.follow(v, trusted)
        told = Residual(self, v, base, blend, expected, source)
        vector = told.decode()
        self.store(v.at, vector, told.along, told.across, told.fine)
        self.last = vector
        if kind < 0:
            return
        energy = (1 << 15) + sum(dot(f, f) for f in features)
        for k in range(3):
            error = clip((vector[k] - blend[k]) * inverse >> 24, -1023, 1023)
            gain = error * (8 << 24) // energy
            for n in range(FEATURES):
                weights[n] = clip(weights[n] + (features[n][k] * gain >> 14), -(1 << 20), 1 << 20)


def likely(length: int) -> int:
    """Class of a length that is likely."""
    return clip((length * 28 >> 16) + 3, 0, 31)


def at_top(v: Voxel, axis: int, a: int) -> int:
    """The length beside one at the top, as the other neighbours make it."""
    others = [(cell.length, cell.ahead[n]) for n, cell in enumerate(v.faces) if cell and n != axis]
    total = sum(b if b >= SATURATED else ahead for b, ahead in others)
    return total // len(others) if others and total < len(others) * (SATURATED - 1024) else a


def scaled(v: Place, inverse: int) -> Place:
    """A feature, 1/256 steps."""
    x, y, z = (clip(c * inverse >> 24, -4095, 4095) for c in v)
    return x, y, z
