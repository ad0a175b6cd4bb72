"""Entropies of quantised fields: the identity of voxel and object, joint measures, and spatial blocks."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray

from touchfield.errors import InvalidArgument
from touchfield.measure import information as info
from touchfield.measure.counts import Counts
from touchfield.measure.estimators import binary_entropy_bits
from touchfield.measure.field_count import Boxes, BrickGroups, field_counts, field_entropy
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.measure.quantity import FewSamplesWarning
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import Grid
from touchfield.pipeline.partition import SymbolFrames

pytestmark = pytest.mark.filterwarnings("ignore::touchfield.measure.quantity.FewSamplesWarning")
K = 9


def grid_of(*shape: int) -> Grid:
    x, y, z = shape
    return Grid((x, y, z), (1e-3,) * 3, (0, 0, 0))


def random_symbols(grid: Grid, seed: int, density: float = 0.2) -> NDArray[np.int32]:
    """Symbols in a part of the lattice."""
    rng = np.random.default_rng(seed)
    s = np.minimum(rng.geometric(0.4, grid.shape), K - 1) * (rng.random(grid.shape) < density)
    s[:, :, grid.shape[2] // 2 :] = 0
    return s.astype(np.int32)


def field(grid: Grid, seed: int, density: float = 0.2) -> FieldSymbols:
    return FieldSymbols.from_dense(grid, random_symbols(grid, seed, density), K, "a Q")


def joint(first: Any, second: Any, over: str = "voxel", interval: bool = True) -> Counts:
    return field_counts(first, second, (over,), interval=interval)[over]


# -- one field ---------------------------------------------------------------------------------------------


@given(
    st.tuples(st.integers(1, 20), st.integers(1, 12), st.integers(2, 17)),
    st.integers(0, 1000),
    st.sampled_from([0.02, 0.3, 1.0]),
    st.integers(1, 3),
)
def test_voxel_and_object_entropy(shape: tuple[int, int, int], seed: int, density: float, count: int) -> None:
    """H_voxel = h2(p) + p H_object exactly, and both agree with the dense array."""
    grid = grid_of(*shape)
    frames = [field(grid, seed + i, density) for i in range(count)]
    dense = np.stack([f.to_dense() for f in frames])
    voxel = field_entropy(frames, interval=False)
    assert float(voxel) == pytest.approx(float(info.entropy(dense, interval=False)), abs=1e-12)
    assert voxel.samples == dense.size
    if not dense.any():
        with pytest.raises(InvalidArgument, match="no voxel with a force"):
            field_entropy(frames, "object")
        return
    p = np.count_nonzero(dense) / dense.size
    object_entropy = field_entropy(frames, "object", interval=False)
    assert float(voxel) == pytest.approx(binary_entropy_bits(p) + p * float(object_entropy), abs=1e-12)
    assert float(object_entropy) == pytest.approx(
        float(info.entropy(dense[dense != 0], interval=False)), abs=1e-12
    )


def test_voxel_and_object_entropy_of_other_estimators() -> None:
    """H_voxel = h2(p) + p H_object holds for plug-in estimates; bias corrections break it."""
    f = field(grid_of(16, 16, 16), 1, 0.05)
    p = f.object_count / f.voxel_count
    differences = {}
    for estimator in ("plug-in", "miller-madow"):
        voxel, object_bits = (
            float(field_entropy(f, o, estimator=estimator, interval=False)) for o in ("voxel", "object")
        )
        differences[estimator] = voxel - binary_entropy_bits(p) - p * object_bits
    # (K - 1) / 2n of K symbols and V voxels, and of K - 1 and p V: times p they differ by 1 / 2V
    assert differences["plug-in"] == pytest.approx(0, abs=1e-12)
    assert differences["miller-madow"] == pytest.approx(1 / (2 * f.voxel_count * math.log(2)), rel=1e-6)


def test_lattice_larger_than_the_memory() -> None:
    """1.15e18 voxels, 512 of them with a force: H_voxel = h2(p) + p H_object holds."""
    grid = grid_of(1 << 20, 1 << 20, 1 << 20)
    symbols = np.arange(512, dtype=np.int32).reshape(1, 8, 8, 8) % 8 + 1
    symbols_field = FieldSymbols(grid, np.array([[77, 1234, 99]], np.int32), symbols, K, "a Q")
    voxel, object_entropy = field_entropy(symbols_field), field_entropy(symbols_field, "object")
    assert float(object_entropy) == 3 and voxel.samples == 1 << 60
    p = 512 / 2**60
    assert float(voxel) == pytest.approx(p * (3 + 51 + 1 / math.log(2)), rel=1e-3)
    assert voxel.interval is None and "no interval" in voxel.notes[0]  # one brick holds all that varies
    with pytest.raises(InvalidArgument, match=r"2\^63"):
        field_entropy([symbols_field] * 8)


def test_metadata_of_a_field_entropy() -> None:
    f = field(grid_of(40, 40, 40), 1)
    voxel, object_entropy = field_entropy(f), field_entropy(f, "object")
    assert (voxel.name, voxel.unit, voxel.quantiser) == ("H(S)", "bit/sample", "a Q")
    assert (voxel.weighting, object_entropy.weighting) == ("voxel", "object")
    assert (voxel.symbols, object_entropy.symbols) == (K, K - 1)
    assert (voxel.samples, object_entropy.samples) == (64_000, f.object_count)
    for q, blocks in ((voxel, 12), (object_entropy, 9)):
        assert q.dependence is not None and q.dependence.blocks == blocks
        assert q.interval is None or q.interval.low < float(q) < q.interval.high
    other = field_entropy(f, "object", estimator="chao-wang-jost", interval=False)
    assert other.estimator == "chao-wang-jost" and float(other) == pytest.approx(
        float(object_entropy), abs=0.01
    )
    assert field_entropy(f, interval=False).interval is None


def test_repeated_frames_do_not_narrow_the_interval() -> None:
    f = field(grid_of(64, 64, 64), 2, 1.0)
    for over in ("voxel", "object"):
        single, repeated = field_entropy(f, over).interval, field_entropy([f] * 5, over).interval
        assert (single is None) == (repeated is None) == (over == "voxel"), "its voxels have a trend"
        if single is not None and repeated is not None:
            assert (repeated.low, repeated.high) == pytest.approx((single.low, single.high), abs=1e-9)


def test_fields_without_an_interval() -> None:
    q = field_entropy(field(grid_of(9, 9, 20), 3), "voxel")
    assert q.dependence is not None  # 12 bricks
    for over in ("voxel", "object"):
        small = field_entropy(field(grid_of(9, 8, 20), 3), over)
        assert small.interval is None and any("too few bricks" in n for n in small.notes)


# -- two fields --------------------------------------------------------------------------------------------


@given(st.integers(0, 1000), st.sampled_from([0.0, 0.02, 0.4]))
def test_joint_measures_agree_with_dense_arrays(seed: int, density: float) -> None:
    grid = grid_of(11, 17, 9)
    first = [field(grid, seed + i, 0.1) for i in range(2)]
    second = [replace(field(grid, seed + 7 + i, density), alphabet=20, quantiser="another") for i in range(2)]
    x, y = (np.stack([f.to_dense() for f in frames]) for frames in (first, second))
    either = (x != 0) | (y != 0)
    for over, (a, b) in {"voxel": (x, y), "object": (x[either], y[either])}.items():
        found = joint(first, second, over, False)
        pairs = [
            (info.entropy(found, column=0), info.entropy(a, interval=False)),
            (info.entropy(found, column=1), info.entropy(b, interval=False)),
            (info.joint_entropy(found), info.joint_entropy(a, b, interval=False)),
            (info.conditional_entropy(found), info.conditional_entropy(a, b, interval=False)),
            (info.conditional_entropy(found, given=0), info.conditional_entropy(b, a, interval=False)),
            (info.mutual_information(found), info.mutual_information(a, b, interval=False)),
            (info.variation_of_information(found), info.variation_of_information(a, b, interval=False)),
            (
                info.normalised_mutual_information(found),
                info.normalised_mutual_information(a, b, interval=False),
            ),
        ]
        for q, expected in pairs:
            assert float(q) == pytest.approx(float(expected), abs=1e-12, nan_ok=True), q.name
            assert q.symbols == expected.symbols and q.samples == a.size
            assert (q.weighting, q.quantiser) == (over, "a Q; another")


def test_a_field_and_itself() -> None:
    f = field(grid_of(32, 32, 32), 6)
    found = joint(f, f)
    shared = info.mutual_information(found)
    assert found.quantiser == "a Q"
    assert float(info.variation_of_information(found)) == pytest.approx(0, abs=1e-12)
    assert float(info.normalised_mutual_information(found)) == pytest.approx(1)
    assert float(shared) == pytest.approx(float(field_entropy(f)), abs=1e-12)
    assert shared.dependence is not None


def test_joint_measures_warn() -> None:
    grid = grid_of(8, 8, 2)
    found = joint(field(grid, 7, 1.0), field(grid, 8, 1.0), "object")
    with pytest.warns(FewSamplesWarning):
        assert any("few samples" in n for n in info.mutual_information(found).notes)


# -- frames that are made when asked for -------------------------------------------------------------------


class IdentityFrame(FieldSymbols):
    """A frame that equals only itself, for a weak set."""

    __hash__ = object.__hash__

    def __eq__(self, other: object) -> bool:
        return self is other


class CountingFrames(Sequence[FieldSymbols]):
    """Lazy frames that count their accesses and the maximum number alive at once."""

    def __init__(self, frames: list[FieldSymbols], alive: weakref.WeakSet[Any] | None = None) -> None:
        self._frames, self.times, self.max_alive = frames, [0] * len(frames), 0
        self._alive: weakref.WeakSet[Any] = weakref.WeakSet() if alive is None else alive

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: Any) -> Any:
        frame = IdentityFrame(**vars(self._frames[index]))
        self.times[index] += 1
        self._alive.add(frame)
        self.max_alive = max(self.max_alive, len(self._alive))
        return frame


WAYS: dict[str, tuple[Callable[[Any], Any], int]] = {
    "voxel": (lambda f: field_entropy(f), 1),
    "voxel, no interval": (lambda f: field_entropy(f, interval=False), 1),
    "voxel, many blocks": (lambda f: field_entropy(f, blocks=1 << 21), 2),
    "object": (lambda f: field_entropy(f, "object"), 2),
    "object, no interval": (lambda f: field_entropy(f, "object", interval=False), 1),
}


@pytest.mark.parametrize("case", WAYS)
def test_one_frame_is_alive_and_computed_few_times(case: str) -> None:
    measure, passes = WAYS[case]
    frames = [field(grid_of(20, 20, 40), n) for n in range(5)]
    lazy = CountingFrames(frames)
    assert measure(lazy) == measure(frames)
    assert lazy.max_alive == 1 and lazy.times == [passes] * 5


@pytest.mark.parametrize(
    ("over", "interval", "alphabet", "passes"),
    [
        ("voxel", True, K, 1),
        ("voxel", True, 1 << 16, 2),
        ("voxel", False, 1 << 16, 1),
        ("object", True, K, 2),
        ("object", False, K, 1),
    ],
)
def test_one_pair_is_alive_and_computed_few_times(
    over: str, interval: bool, alphabet: int, passes: int
) -> None:
    grid = grid_of(20, 20, 40)
    alive: weakref.WeakSet[Any] = weakref.WeakSet()
    sides = [[replace(field(grid, s + n), alphabet=alphabet) for n in range(5)] for s in (0, 50)]
    first, second = (CountingFrames(frames, alive) for frames in sides)
    lazy_counts, expected = joint(first, second, over, interval), joint(*sides, over, interval)
    assert info.mutual_information(lazy_counts) == info.mutual_information(expected)
    assert max(first.max_alive, second.max_alive) == 2 and first.times == second.times == [passes] * 5


def test_frames_are_computed_once_per_pass() -> None:
    fields = [field(grid_of(20, 20, 40), n) for n in range(6)]
    requested: list[int] = []

    def quantise(n: int) -> FieldSymbols:
        requested.append(n)
        return fields[n]

    frames = SymbolFrames(range(6), quantise)  # type: ignore[arg-type]
    found = joint(frames[1:], frames[:-1], interval=False)
    plain = joint(fields[1:], fields[:-1], interval=False)
    assert info.mutual_information(found) == info.mutual_information(plain) and sorted(requested) == list(
        range(6)
    )


def test_one_pass_and_two_passes_agree() -> None:
    """A large alphabet uses another algorithm with the same counts, also where no voxel is empty."""
    grid = grid_of(33, 20, 41)
    for full in (False, True):
        symbols = random_symbols(grid, 1) + full
        small_alphabet, large_alphabet = (
            FieldSymbols.from_dense(grid, symbols, k, "a Q") for k in (20, 1 << 20)
        )
        assert field_entropy(small_alphabet).dependence is not None
        assert field_entropy([small_alphabet, small_alphabet]) == field_entropy(
            [large_alphabet, large_alphabet]
        )


def test_frames_that_change_between_passes() -> None:
    class Changing(CountingFrames):
        to: int

        def __getitem__(self, index: Any) -> Any:
            f = super().__getitem__(index)
            again = self.times[index] > 1
            symbols = np.where(f.symbols != 0, self.to, 0).astype(np.int32) if again else f.symbols
            return FieldSymbols(f.grid, f.bricks, symbols, K, "a Q")

    frames = [replace(field(grid_of(32, 32, 32), n, 1.0), alphabet=K) for n in range(2)]
    frames = [replace(f, symbols=np.minimum(f.symbols, K - 2)) for f in frames]
    # other numbers of known symbols; a symbol that the first pass did not have
    for Changing.to in (
        1,
        K - 1,
    ):
        with pytest.raises(InvalidArgument, match="second pass"):
            field_entropy(Changing(frames), "object")


def test_each_frame_is_checked_in_each_pass() -> None:
    frames: list[Any] = [field(grid_of(16, 16, 16), n) for n in range(3)]
    for wrong in (replace(frames[0], quantiser="another Q"), field(grid_of(16, 16, 8), 0), "no frame"):
        bad = [*frames[:2], wrong]
        for measure, _ in WAYS.values():
            with pytest.raises(InvalidArgument, match="fields, frame 2"):
                measure(bad)
        for first, second in ((frames, bad), (bad, frames)):
            with pytest.raises(InvalidArgument, match="frame 2"):
                joint(first, second)
    for no_sequence in (iter(frames), 5, None):
        with pytest.raises(InvalidArgument, match="a sequence of them"):
            field_entropy(no_sequence)  # type: ignore[arg-type]


# -- refusals ----------------------------------------------------------------------------------------------


def test_mismatched_frames_are_refused() -> None:
    grid = grid_of(16, 16, 16)
    f = field(grid, 9)
    for other in (replace(f, alphabet=K + 1), replace(f, quantiser="another Q")):
        with pytest.raises(InvalidArgument, match="frame 1: found the quantiser"):
            field_entropy([f, other])
    moved = replace(f, grid=Grid(grid.shape, (2e-3,) * 3, (0, 0, 0)))
    with pytest.raises(InvalidArgument, match="frame 1: found the grid"):
        field_entropy([f, moved])
    with pytest.raises(InvalidArgument, match="second: found the grid"):
        joint(f, moved)
    with pytest.raises(InvalidArgument, match="second: found 1 frames"):
        joint([f, f], f)
    for over in ("samples", "interaction", "voxels"):
        with pytest.raises(InvalidArgument, match='"voxel" or "object"'):
            field_entropy(f, over)
        with pytest.raises(InvalidArgument, match='"voxel" or "object"'):
            joint(f, f, over)
    with pytest.raises(InvalidArgument, match="no frame"):
        field_entropy([])
    with pytest.raises(InvalidArgument, match="frame 0: found a ndarray"):
        field_entropy([np.zeros(3)])  # type: ignore[list-item]
    with pytest.raises(InvalidArgument, match="8 or more"):
        field_entropy(f, blocks=7)
    assert field_entropy(f, blocks=8).samples == f.voxel_count
    empty = FieldSymbols.from_dense(grid, np.zeros(grid.shape, np.int32), K, "a Q")
    assert float(field_entropy(empty)) == 0
    for empties in (
        lambda: field_entropy(empty, "object"),
        lambda: info.entropy(joint(empty, empty, "object")),
    ):
        with pytest.raises(InvalidArgument, match=r"no voxel with a force|no sample"):
            empties()


# -- parts of space ----------------------------------------------------------------------------------------


@given(st.tuples(*[st.integers(1, 90)] * 3), st.integers(1, 70))
def test_boxes_cover_the_lattice(shape: tuple[int, int, int], max_boxes: int) -> None:
    grid = grid_of(*shape)
    boxes = Boxes.of_bricks(grid, max_boxes)
    assert 1 <= boxes.count <= max_boxes
    bricks = np.argwhere(np.ones(grid.brick_shape)).astype(np.int32)
    inside = np.ones(len(bricks), np.int64)
    for axis, n in enumerate(grid.shape):
        inside *= np.minimum(8, n - 8 * bricks[:, axis])
    counted = np.bincount(boxes.owner(bricks)[:, 0], weights=inside, minlength=boxes.count)
    assert np.array_equal(boxes.voxels, counted) and counted.min() > 0


def test_groups_are_equally_large_and_compact() -> None:
    grid = grid_of(64, 64, 64)
    bricks = np.argwhere(np.random.default_rng(0).random(grid.brick_shape) < 0.5).astype(np.int32)
    groups = BrickGroups.of(grid, brick_keys(grid, bricks), 20)
    owner = groups.owner(bricks)[:, 0]
    sizes = np.bincount(owner)
    assert groups.count == len(sizes) == 20 and sizes.max() - sizes.min() <= 1
    spread = [np.ptp(bricks[owner == b], axis=0).prod() for b in range(20)]
    assert np.median(spread) <= 3**3  # in storage order a group would be a plate of 8 x 8


def gaussian_field(rng: np.random.Generator, n: int, length: float) -> np.ndarray:
    """A periodic Gaussian field of variance 1, correlation exp(-r^2 / 2 length^2), n^3 of (2 n)^3 samples."""
    k = np.fft.fftfreq(2 * n)
    square = k[:, None, None] ** 2 + k[None, :, None] ** 2 + k[None, None, :] ** 2
    gain = np.exp(-((np.pi * length) ** 2) * square)
    white = np.fft.rfftn(rng.normal(size=(2 * n,) * 3))
    smooth = np.fft.irfftn(white * gain[..., : n + 1], (2 * n,) * 3, axes=(0, 1, 2))
    return smooth[:n, :n, :n] / np.sqrt((gain**2).mean())


def test_intervals_cover_the_entropy_of_correlated_fields() -> None:
    """Seeded: 40 draws of 48^3 samples with a correlation length of 3.5; at least 90 % are covered."""
    rng, edges = np.random.default_rng(11), np.linspace(-2, 2, 7)
    p = np.diff([0.0, *(0.5 * (1 + math.erf(e / math.sqrt(2))) for e in edges), 1.0])
    truth, covered = -(p * np.log2(p)).sum(), {"voxel": 0, "object": 0}
    for _ in range(40):
        symbols = (np.digitize(gaussian_field(rng, 48, 3.5), edges) + 1).astype(np.int32)
        drawn_field = FieldSymbols.from_dense(grid_of(48, 48, 48), symbols, 9, "levels")
        for over in covered:
            i = field_entropy(drawn_field, over).interval
            assert i is not None, over
            covered[over] += i.low <= truth <= i.high
    assert min(covered.values()) >= 36, covered
