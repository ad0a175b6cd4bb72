"""The pose coder: quantised poses keep the force within the mask, and the bytes are what the document says."""

from __future__ import annotations

import importlib.util
import sys
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from touchfield.codec.pose_steps import field_bounds
from touchfield.codec.pose_track import MOST_POSES, PoseSteps, decode_poses, encode_poses, pose_steps
from touchfield.errors import CorruptFile, FormatError, InvalidArgument, TruncatedFile
from touchfield.medium import ForceField, Grid
from touchfield.medium.pose_track import PoseTrack

FINE = PoseSteps(2.0**-16, 2.0**-15)
"""What a wall of 1 N/mm, 7 cm from the body's origin, needs where 0.05 N are felt."""

steps_of_all_sizes = st.builds(
    lambda p, q: PoseSteps(2.0**p, 2.0**q), st.integers(-40, 0), st.integers(-30, -2)
)  # fmt: skip


def random_track(rng: np.random.Generator, count: int, reach_m: float = 0.3) -> PoseTrack:
    return PoseTrack(rng_units(rng, count), rng.uniform(-reach_m, reach_m, (count, 3)))


def rng_units(rng: np.random.Generator, count: int) -> np.ndarray:
    q = rng.normal(size=(count, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def falling(count: int, seed: int = 0, rate_hz: float = 1000.0, every_s: float = 0.4) -> PoseTrack:
    """A tumbling body that bounces every so often: parabolas, and a new spin of some 10 rad/s at each bounce."""
    rng = np.random.default_rng(seed)
    bounce, phase_s = np.divmod(np.arange(count) / rate_hz, every_s)
    height = 9.81 / 2 * phase_s * (every_s - phase_s)
    drift = rng.normal(0, 0.3, (len(set(bounce)), 2))[bounce.astype(int)] / rate_hz
    turn, quaternions = Rotation.identity(), []
    for one in np.unique(bounce):
        spin = rng.normal(0, 6, 3)
        during = turn * Rotation.from_rotvec(phase_s[bounce == one][:, None] * spin)
        quaternions.append(during.as_quat()[:, [3, 0, 1, 2]])
        turn = turn * Rotation.from_rotvec(every_s * spin)
    return PoseTrack(np.concatenate(quaternions), np.column_stack([np.cumsum(drift, axis=0), height]))


# -- steps ------------------------------------------------------------------------------------------------


@st.composite
def fields(draw: st.DrawFn) -> ForceField:
    """Noise, sparse or dense, on small lattices of any proportion that do not end with a brick."""
    shape = tuple(draw(st.lists(st.integers(1, 11), min_size=3, max_size=3)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    held = rng.random(shape) < draw(st.sampled_from([0.02, 0.3, 1.0]))
    held[tuple(rng.integers(0, shape))] = True
    grid = Grid(shape, tuple(rng.uniform(0.5e-3, 3e-3, 3)), tuple(rng.uniform(-0.03, 0.03, 3)))
    return ForceField.from_dense(grid, held[..., None] * rng.normal(0, 2, (*shape, 3)))


def force(field: ForceField, track: PoseTrack, frame: int, points_m: np.ndarray) -> np.ndarray:
    return field.sample_n(track.to_body(points_m, frame)).astype(np.float64) @ track.rotation(frame).T


def errors_n(field: ForceField, track: PoseTrack, decoded: PoseTrack, rng: np.random.Generator) -> np.ndarray:
    """|F_decoded - F| in the scene, at random points about samples that hold a force."""
    worst = []
    for frame in range(len(track)):
        near = field.positions()[rng.integers(0, field.support_count, 200)] + rng.uniform(-1.1, 1.1, (200, 3))
        points = track.to_scene(field.grid.to_m(near), frame)
        change = force(field, decoded, frame, points) - force(field, track, frame, points)
        worst.append(np.linalg.norm(change, axis=1).max())
    return np.array(worst)


@given(fields(), st.floats(0.003, 3), st.floats(0.05, 1), st.integers(0, 2**32 - 1))
def test_quantised_poses_keep_the_force_within_the_share(
    field: ForceField, f0_n: float, share: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    steps, track = pose_steps(field, f0_n=f0_n, share=share), random_track(rng, 6)
    decoded = decode_poses(encode_poses(track, steps), 6, steps)
    rounding = 1e-6 * field.support().amplitudes_n.max()  # `sample_n` gives float32
    assert (errors_n(field, track, decoded, rng) <= share * f0_n + rounding).all()


def test_the_steps_are_not_much_finer_than_they_must_be() -> None:
    """Some pose of many does a tenth of the harm that the bound allows."""
    rng = np.random.default_rng(3)
    grid = Grid((5, 5, 5), (1e-3,) * 3, (0.02, -0.002, -0.002))
    field = ForceField.from_support(grid, [[2, 2, 2]], [[2.0, 0, 0]])
    steps, track = pose_steps(field, f0_n=0.05), random_track(rng, 300)
    decoded = decode_poses(encode_poses(track, steps), 300, steps)
    assert 0.1 * 0.025 < errors_n(field, track, decoded, rng).max() <= 0.025


@given(fields())
def test_bounds_of_a_field_are_those_of_its_cells(field: ForceField) -> None:
    dense = np.pad(field.to_dense().astype(np.float64), [(1, 1)] * 3 + [(0, 0)])
    steepest = 0.0
    slopes = [np.diff(dense, axis=axis) / field.grid.spacing_m[axis] for axis in range(3)]
    n = np.array(dense.shape[:3]) - 1
    for corner in np.ndindex(2, 2, 2):
        columns = []
        for axis, slope in enumerate(slopes):
            sides = [slice(0, n[axis]) if other == axis else slice(c, c + n[other]) for other, c in enumerate(corner)]
            sides[axis] = slice(0, n[axis])
            columns.append(slope[tuple(sides)])
        steepest = max(steepest, np.linalg.norm(np.stack(columns, axis=-1), 2, axis=(-2, -1)).max())
    spacing = np.array(field.grid.spacing_m)
    cells = np.abs(field.grid.to_m(field.positions())) + spacing
    expected = steepest, np.linalg.norm(cells, axis=1).max(), np.linalg.norm(dense, axis=-1).max()
    assert field_bounds(field) == pytest.approx(expected, rel=1e-6)
    assert (np.array(field_bounds(field)) >= expected).all()


@given(fields(), st.floats(0.01, 1))
def test_steps_fill_the_share_and_twice_as_coarse_ones_would_not(field: ForceField, f0_n: float) -> None:
    steepest, reach, strongest = field_bounds(field)

    def bound(position_m: float, quaternion: float) -> float:
        return np.sqrt(3) / 2 * steepest * position_m + 2 * (steepest * reach + strongest) * quaternion

    steps = pose_steps(field, f0_n=f0_n)
    assert bound(steps.position_m, steps.quaternion) <= f0_n / 2
    assert bound(2 * steps.position_m, steps.quaternion) > f0_n / 2
    assert bound(steps.position_m, 2 * steps.quaternion) > f0_n / 2 or steps.quaternion == 0.25


@given(fields(), fields())
def test_a_field_that_deforms_takes_the_steps_of_its_worst_frames(a: ForceField, b: ForceField) -> None:
    both, alone = pose_steps([a, b], f0_n=0.05), [pose_steps(one, f0_n=0.05) for one in (a, b)]
    assert pose_steps([a, a], f0_n=0.05) == alone[0]
    powers = [3 * np.log2(s.position_m) + 4 * np.log2(s.quaternion) for s in (both, *alone)]
    assert powers[0] <= min(powers[1:])


def test_steps_without_a_force_are_the_coarsest() -> None:
    empty = ForceField.empty(Grid((4, 4, 4), (1e-3,) * 3, (0, 0, 0)))
    assert pose_steps(empty, f0_n=0.05) == pose_steps([], f0_n=0.05) == PoseSteps(1.0, 0.25)


@pytest.mark.parametrize(("f0_n", "share"), [(0.0, 0.5), (np.nan, 0.5), (0.05, 0.0), (0.05, 1.5), (1e-15, 0.5)])
def test_steps_of_impossible_masks_are_refused(f0_n: float, share: float, wavy_field: ForceField) -> None:
    with pytest.raises(InvalidArgument):
        pose_steps(wavy_field, f0_n=f0_n, share=share)


@given(steps_of_all_sizes)
def test_steps_are_two_bytes(steps: PoseSteps) -> None:
    assert len(steps.to_bytes()) == 2
    assert PoseSteps.from_bytes(steps.to_bytes()) == steps


def test_faulty_steps_are_refused() -> None:
    with pytest.raises(TruncatedFile):
        PoseSteps.from_bytes(b"\0")
    for data in (b"\0\0\0", b"\x01\xf0", b"\xf0\xff", b"\xf0\x80"):
        with pytest.raises(CorruptFile):
            PoseSteps.from_bytes(data)
    for pair in ((0.3, 0.25), (2.0, 0.25), (1.0, 0.5), (-1.0, 0.25), (np.nan, 0.25), (2.0**-41, 0.25)):
        with pytest.raises(InvalidArgument):
            PoseSteps(*pair)


# -- round trips ------------------------------------------------------------------------------------------


@given(steps_of_all_sizes, st.integers(1, 40), st.integers(0, 2**32 - 1), st.floats(0, 800))
def test_tracks_return_to_within_half_a_step_and_then_unchanged(
    steps: PoseSteps, count: int, seed: int, reach_m: float
) -> None:
    track = random_track(np.random.default_rng(seed), count, reach_m)
    decoded = decode_poses(encode_poses(track, steps), count, steps)
    assert np.abs(decoded.positions_m - track.positions_m).max() <= steps.position_m / 2
    turn = np.linalg.norm(decoded.rotations() - track.rotations(), 2, axis=(1, 2))
    assert turn.max() <= 2 * steps.quaternion + 1e-14
    assert decode_poses(encode_poses(decoded, steps), count, steps) == decoded


@pytest.mark.parametrize("power", [-2, -3, -8, -15, -30])
def test_quarter_turns_and_spins_through_the_ambiguous_sign_return(power: int) -> None:
    steps = PoseSteps(2.0**-10, 2.0**power)
    angles = np.concatenate([np.arange(9) * np.pi / 2, np.linspace(0, 20, 60)])
    for axis in np.eye(3):
        track = PoseTrack(Rotation.from_rotvec(angles[:, None] * axis).as_quat()[:, [3, 0, 1, 2]], np.zeros((69, 3)))
        decoded = decode_poses(encode_poses(track, steps), 69, steps)
        assert np.linalg.norm(decoded.rotations() - track.rotations(), 2, axis=(1, 2)).max() <= 2 * 2.0**power + 1e-14
        assert decode_poses(encode_poses(decoded, steps), 69, steps) == decoded


def test_cheap_tracks_are_cheap() -> None:
    assert len(encode_poses(PoseTrack.still(2000), FINE)) <= 8
    assert len(encode_poses(PoseTrack.still(MOST_POSES, (0.1, -0.2, 0.3)), FINE)) <= 16
    tumbling = falling(2000)
    assert len(encode_poses(tumbling, FINE)) <= 3000
    assert len(encode_poses(tumbling.between(0, 300), FINE)) < 0.25 * len(encode_poses(tumbling, FINE))


def test_each_component_has_the_order_that_suits_it() -> None:
    """Ramps and parabolas of whole steps leave nothing to code but their first numbers."""
    i = np.arange(1000)
    for numbers in (3 * i, i * i, 2 * (i - 400) ** 2):
        track = PoseTrack(np.tile([1.0, 0, 0, 0], (1000, 1)), np.stack([numbers] * 3, axis=1) * FINE.position_m)
        assert len(encode_poses(track, FINE)) < 60


def test_tracks_beyond_the_limits_are_refused() -> None:
    with pytest.raises(InvalidArgument, match="poses"):
        encode_poses(PoseTrack.still(MOST_POSES + 1), FINE)
    with pytest.raises(InvalidArgument, match="origin"):
        encode_poses(PoseTrack.still(2, (0, 0, 2000.0)), PoseSteps(2.0**-40, 0.25))
    with pytest.raises(InvalidArgument):
        encode_poses(PoseTrack.still(2, (0, 0, 1e300)), FINE)
    for count in (0, -1, MOST_POSES + 1):
        with pytest.raises(InvalidArgument):
            decode_poses(b"", count, FINE)


def test_the_largest_jumps_return() -> None:
    """Positions from one end of the range to the other and back: residuals of the most bits."""
    steps = PoseSteps(2.0**-40, 2.0**-30)
    ends = 1024.0 * np.array([[1, -1, 1], [-1, 1, -1], [-1, -1, 1], [1, 1, -1]] * 5)
    track = PoseTrack(rng_units(np.random.default_rng(0), 20), ends)
    assert np.array_equal(decode_poses(encode_poses(track, steps), 20, steps).positions_m, ends)


# -- the document -----------------------------------------------------------------------------------------


def reference() -> Any:
    """The decoder of the conformance suite: it shares no code with the package."""
    path = Path(__file__).resolve().parents[1] / "conformance" / "reference_decoder.py"
    spec = importlib.util.spec_from_file_location("reference_decoder", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def numbers_by_the_document(data: bytes, frame_count: int) -> np.ndarray:
    """What POSES_CHAPTER says, literally, on the arithmetic decoder of another hand; int64 [n, 7]."""
    library = reference()
    coder = library.Coder(data)
    models = library.Models(coder)

    def raw(bits: int) -> int:
        return sum(coder.bit(32768) << place for place in range(bits - 1, -1, -1))

    def size(v: int, m: int) -> int:
        length = min(abs(v).bit_length(), m)
        return m - length if v < 0 else m + length

    orders = [raw(2) for _ in range(7)]
    first = []
    for _ in range(7):
        value = 0
        if raw(1):
            m = raw(6)
            value = (1 << m) + raw(m)
            value = -value if raw(1) else value
        first.append(value)
    rows, residuals = [first], [[0, 0, 0] for _ in range(7)]
    for i in range(1, frame_count):
        row = []
        for c, order in enumerate(orders):
            p1, p2, p3 = (rows[max(i - back, 0)][c] for back in (1, 2, 3))
            r1, r2, r3 = residuals[c]
            near = [min(max(r, -2), 2) + 2 for r in (r1, r2, r3)]
            a = 32 * ((((c > 2) * 5 + near[0]) * 5 + near[1]) * 5 + near[2])
            b = 32 * ((21 * c + size(r1, 10)) * 7 + size(r2, 3))
            r = 0
            if order and models.mixed(a, b, 0):
                negative = models.mixed(a + 1, b + 1, 1)
                length = 1
                while models.mixed(a + (j := 1 + min(length, 14)), b + j, j):
                    length += 1
                r = 1
                if length > 1:
                    j = 16 + min(length, 15)
                    r = 2 + models.mixed(a + j, b + j, j)
                if length > 2:
                    r = (r << (length - 2)) + raw(length - 2)
                r = -r if negative else r
            if order:
                residuals[c] = [r, r1, r2]
            row.append([p1, p1 + r, 2 * p1 - p2 + r, 3 * (p1 - p2) + p3 + r][order])
        rows.append(row)
    assert data[: coder.used] + coder.ending() == data
    return np.array(rows)


@pytest.mark.parametrize("kind", ["falling", "still", "random", "jumps"])
def test_the_document_is_enough_to_decode(kind: str) -> None:
    rng, steps = np.random.default_rng(5), FINE
    jumps = PoseTrack(
        rng_units(rng, 30), np.round(rng.normal(0, 1, (30, 3)) * 10.0 ** rng.integers(-4, 3, (30, 1)), 6)
    )
    track = {
        "falling": falling(500), "still": PoseTrack.still(50, (0.1, 0, -0.2)), "random": random_track(rng, 30),
        "jumps": jumps,
    }[kind]  # fmt: skip
    data = encode_poses(track, steps)
    numbers = numbers_by_the_document(data, len(track))
    decoded = decode_poses(data, len(track), steps)
    assert np.array_equal(numbers[:, :3] * steps.position_m, decoded.positions_m)
    q = numbers[:, 3:] / np.linalg.norm(numbers[:, 3:], axis=1, keepdims=True)
    assert np.abs((q * decoded.quaternions).sum(axis=1)) == pytest.approx(1, abs=1e-14)


# -- faults -----------------------------------------------------------------------------------------------


def assert_fault_or_track(data: bytes, count: int, steps: PoseSteps) -> None:
    try:
        track = decode_poses(data, count, steps)
    except FormatError:
        return
    assert len(track) == count


def test_cut_and_longer_bytes_are_not_taken_for_the_track() -> None:
    """A code has no end of its own, so that a cut one may by chance be that of another track."""
    track = falling(100)
    data = encode_poses(track, FINE)
    decoded = decode_poses(data, 100, FINE)
    faults = set()
    for cut in range(len(data)):
        try:
            assert decode_poses(data[:cut], 100, FINE) != decoded
        except FormatError as fault:
            faults.add(type(fault))
    assert faults == {TruncatedFile, CorruptFile}
    with pytest.raises(CorruptFile, match="behind the end"):
        decode_poses(data + b"\0", 100, FINE)
    for count in (50, 200):
        with pytest.raises(FormatError):
            decode_poses(data, count, FINE)


def test_changed_bytes_are_a_fault_or_another_track() -> None:
    data = encode_poses(falling(60), FINE)
    for place in range(len(data)):
        for change in (1, 0x40, 0xFF):
            wrong = bytearray(data)
            wrong[place] ^= change
            assert_fault_or_track(bytes(wrong), 60, FINE)


@given(st.binary(max_size=200), st.integers(1, 300), steps_of_all_sizes)
def test_random_bytes_are_a_fault_or_a_track(data: bytes, count: int, steps: PoseSteps) -> None:
    assert_fault_or_track(data, count, steps)


def test_quaternions_that_are_none_are_corrupt() -> None:
    """Steps other than those of the encoder make quaternions of a wrong length, or numbers beyond the limit."""
    data = encode_poses(PoseTrack.still(3), FINE)
    with pytest.raises(CorruptFile, match="frame 0"):
        decode_poses(data, 3, PoseSteps(FINE.position_m, FINE.quaternion / 2))
    with pytest.raises(CorruptFile, match="limit"):
        decode_poses(data, 3, PoseSteps(FINE.position_m, FINE.quaternion * 2))
    with pytest.raises(FormatError):
        decode_poses(b"", 3, FINE)  # seven zeros would be the shortest code of all


def test_few_bytes_take_no_more_memory_than_poses_do() -> None:
    data = encode_poses(PoseTrack.still(MOST_POSES), FINE)
    tracemalloc.start()
    decode_poses(data, MOST_POSES, FINE)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 500 * MOST_POSES
