"""The error bound of composed fields: the check measures the decoded sum, and the encoder satisfies it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from independent_bound import mask_ratio
from object_makers import F0_N, ball, head_of, moving_scene, tumbling
from touchfield import pipeline
from touchfield.codec.objects.encoder import PLACE_TOLERANCE_M, ObjectsEncoder
from touchfield.codec.objects.error_bound import (
    BoundCheck,
    ComposedRule,
    Moves,
    Pair,
    compare_scenes,
    displacement_m,
    reach_m,
)
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.touch.spec import TouchSpec
from touchfield.container import TouchReader, TouchWriter
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.pipeline.decoded_objects import SceneStream
from touchfield.pipeline.encoding import write_objects
from touchfield.pipeline.spec import EncodeSpec

SPEC = TouchSpec(k=0.1, f0_n=F0_N, effort="fast", segment_frames=3)
BODY_GRID = Grid((19, 18, 17), (0.0007, 0.0007, 0.0007), (-0.0063, -0.006, -0.0056))
WORLD = Grid((26, 24, 20), (0.001, 0.0011, 0.0009), (-0.0125, -0.0126, -0.009))


def single_frame_medium(field: ForceField) -> HapticMedium:
    return HapticMedium.from_frames([field], 1000.0)


def test_equal_errors_report_the_first_voxel() -> None:
    early, late = (BoundCheck(np.array([0.5]), np.array([[frame, 1, 2, 3]]), 1) for frame in (4, 9))
    assert early.merged(late).max_error == (0.5, 4, (1, 2, 3)) and early.merged(late).violations == 2


def noise(seed: int, size_n: float) -> ForceField:
    rng = np.random.default_rng(seed)
    supported = rng.random(BODY_GRID.shape) < 0.4
    return ForceField.from_dense(
        BODY_GRID, supported[..., None] * rng.normal(0, size_n, (*BODY_GRID.shape, 3))
    )


def crossing(frames: int = 9, strength_n: float = 2.0) -> HapticScene:
    """Two balls that rotate and pass through each other, and a third that stays next to them."""
    tracks = (
        tumbling(frames, 0.002, 0.05),
        tumbling(frames, -0.002, -0.07),
        PoseTrack.constant(frames, (0.0, 0.004, 0.0)),
    )
    fall = np.array([0.0, 0.0, 0.02])
    tracks = tuple(
        PoseTrack(t.quaternions, t.positions_m - fall * (t.positions_m[:, 2:] > 0.005)) for t in tracks
    )
    bodies = [
        HapticObject(f"ball {i}", single_frame_medium(ball(BODY_GRID, 0.005 - 0.0005 * i, strength_n)), track)
        for i, track in enumerate(tracks)
    ]
    return HapticScene(WORLD, 1000.0, tuple(bodies), 3.0)


def error_ratios(source: HapticScene, decoded: HapticScene, frame: int) -> np.ndarray:
    """|error| / mask at every voxel of a frame, with the source's bodies at the decoded poses."""
    moved = tuple(replace(a, track=b.track) for a, b in zip(source.objects, decoded.objects, strict=True))
    x = replace(source, objects=moved).voxelise()[frame].to_dense().astype(np.float64)
    y = decoded.voxelise()[frame].to_dense().astype(np.float64)
    error, force = (np.linalg.norm(v, axis=-1) for v in (y - x, x))
    return np.asarray(error / np.maximum(F0_N, 0.1 * force))


def encode_scene(path: Path, scene: HapticScene, spec: TouchSpec | PaperSpec = SPEC) -> SceneStream:
    encoder = ObjectsEncoder(scene, spec, F0_N)
    with TouchWriter(path) as writer:
        writer.write_head(head_of(scene, encoder))
        write_objects(writer, encoder, len(scene))
    reader = TouchReader(path)
    return SceneStream(reader)


@pytest.mark.parametrize("seed", range(4))
def test_check_agrees_with_the_composed_fields(seed: int) -> None:
    """Rotated, overlapping noise: the largest ratio, its voxel, and the number of violations."""
    scene = crossing(5)
    fields = [noise(10 * seed + i, 1.5) for i in range(3)]
    decoded_fields = [field + noise(1000 + i, 0.1) for i, field in enumerate(fields)]
    source = replace(
        scene,
        objects=tuple(
            replace(o, medium=single_frame_medium(f)) for o, f in zip(scene.objects, fields, strict=True)
        ),
    )
    decoded = replace(
        scene,
        objects=tuple(
            replace(o, medium=single_frame_medium(f))
            for o, f in zip(scene.objects, decoded_fields, strict=True)
        ),
    )
    found, away_m = compare_scenes(source, decoded, 0.1, F0_N)
    expected = np.stack([error_ratios(source, decoded, frame) for frame in range(5)])
    ratio, frame, voxel = found.max_error
    assert away_m < 1e-12 and expected.max() > 1
    assert ratio == pytest.approx(expected.max(), rel=1e-5)
    assert expected[(frame, *voxel)] == pytest.approx(ratio, rel=1e-5)
    assert found.violations == np.count_nonzero(expected > 1)


def test_check_of_single_frames_agrees_with_all_frames() -> None:
    """Bodies that rest for a while until another reaches them: checking frame by frame finds the same."""
    scene = crossing(9)
    first = scene.objects[0].track
    stop = PoseTrack(
        np.concatenate([first.quaternions[:4], first.quaternions[[3] * 5]]),
        np.concatenate([first.positions_m[:4], first.positions_m[[3] * 5]]),
    )
    scene = replace(scene, objects=(replace(scene.objects[0], track=stop), *scene.objects[1:]))
    pairs = [Pair(body.field(0), body.field(0) + noise(i, 0.1)) for i, body in enumerate(scene.objects)]
    rule, moves = ComposedRule(scene, 0.1, F0_N), Moves.of(scene, [body.track for body in scene.objects])
    together, separate = rule.check(pairs, moves, range(9)), BoundCheck.empty(3)
    for frame in range(9):
        separate = separate.merged(rule.check(pairs, moves, [frame]))
    assert together.violations == separate.violations > 0 and together.max_error == separate.max_error
    np.testing.assert_array_equal(together.ratios, separate.ratios)


def resting_now_and_then(seed: int, frames: int) -> HapticScene:
    """Bodies of noise in a crowd, which move in every frame, in some frames or never.

    Every second one jumps. With an odd seed there are frames in which none moves.
    """
    rates = ((0.0, 0.05, 0.3, 1.0), (0.0, 0.1, 0.2, 0.05))[seed % 2]
    rng, bodies = np.random.default_rng(seed), []
    for n in range(6):
        moves = rng.random((frames, 1)) < rates[n % 4]
        turn = np.cumsum(rng.normal(0, 0.1, (frames, 3)) * moves, axis=0)
        phase = rng.uniform(-1, 1, 3) + np.cumsum(
            rng.normal(0, (0.15, 1.0)[n % 2], (frames, 3)) * moves, axis=0
        )
        quaternions = Rotation.from_rotvec(turn).as_quat(scalar_first=True)
        track = PoseTrack(quaternions, 0.009 * np.sin(phase))
        bodies.append(HapticObject(f"body {n}", single_frame_medium(noise(10 * seed + n, 1.0)), track))
    return HapticScene(WORLD, 1000.0, tuple(bodies), 3.0, 0.5 * (seed % 2))


@pytest.mark.parametrize("seed", range(4))
def test_comparing_what_has_moved_finds_what_comparing_every_frame_in_full_finds(seed: int) -> None:
    """A lone frame is compared in full. Ratios, voxels, violations and marks are equal to the last bit."""
    frames = 24
    scene = resting_now_and_then(seed, frames)
    f0_n = 0.0 if seed == 2 else F0_N
    pairs = [Pair(body.field(0), body.field(0) + noise(n, 0.1)) for n, body in enumerate(scene.objects)]
    rule, moves = ComposedRule(scene, 0.1, f0_n), Moves.of(scene, [body.track for body in scene.objects])
    found, separate = rule.check(pairs, moves, range(frames)), BoundCheck.empty(6)
    samples = [np.zeros(0, np.int64)] * 6
    for frame in range(frames):
        separate = separate.merged(rule.check(pairs, moves, [frame]))
        violating = rule.violating_samples(pairs, moves, [frame])
        samples = [np.union1d(a, b) for a, b in zip(samples, violating, strict=True)]
    np.testing.assert_array_equal(found.ratios, separate.ratios)
    np.testing.assert_array_equal(found.voxels, separate.voxels)
    assert found.violations == separate.violations > 1000
    for together, alone in zip(rule.violating_samples(pairs, moves, range(frames)), samples, strict=True):
        np.testing.assert_array_equal(together, alone)


def test_blocks_of_moves_join_without_a_seam() -> None:
    """Velocities at the border of a block need the frames of the next, and a check goes on across it."""
    border, around = 2048, range(2040, 2056)
    scene = resting_now_and_then(1, border + 30)
    tracks = [body.track for body in scene.objects]
    rounded = [PoseTrack(t.quaternions, np.rint(t.positions_m / 1e-4) * 1e-4) for t in tracks]
    moves = Moves.of(scene, rounded)
    blocks = list(moves.blocks(range(len(scene))))
    assert [(frames[0], frames[-1]) for frames, _ in blocks] == [(0, border - 1), (border, len(scene) - 1)]
    poses, source, decoded = (
        np.concatenate(columns) for columns in zip(*(m for _, m in blocks), strict=True)
    )
    for n, (track, other) in enumerate(zip(tracks, rounded, strict=True)):
        # a block may have the other sign of its quaternions
        np.testing.assert_array_equal(np.abs(poses[:, n, :4]), np.abs(other.quaternions))
        np.testing.assert_array_equal(poses[:, n, 4:], other.positions_m)
        for column, of in ((source, track), (decoded, other)):
            np.testing.assert_array_equal(column[:, n], 0.5 * np.hstack(of.velocities(1000.0)))
    pairs = [Pair(body.field(0), body.field(0) + noise(n, 0.1)) for n, body in enumerate(scene.objects)]
    rule, separate = ComposedRule(scene, 0.1, F0_N), BoundCheck.empty(6)
    for frame in around:
        separate = separate.merged(rule.check(pairs, moves, [frame]))
    found = rule.check(pairs, moves, around)
    np.testing.assert_array_equal(found.ratios, separate.ratios)
    np.testing.assert_array_equal(found.voxels, separate.voxels)
    assert found.violations == separate.violations
    assert rule.check(pairs, moves, range(border, around.stop)).violations > 1000


@pytest.mark.parametrize("damping", [0.0, 2.0])
@pytest.mark.parametrize("deforming", [False, True])
def test_file_satisfies_the_bound_at_every_voxel_of_every_frame(
    tmp_path: Path, deforming: bool, damping: float
) -> None:
    scene = moving_scene(7, deforming, damping)
    stream = encode_scene(tmp_path / "a.touch", scene)
    decoded = stream.scene
    for original, restored in zip(scene.objects, decoded.objects, strict=True):
        radius_m = reach_m(original)
        corners = radius_m * np.stack(np.meshgrid(*[[-1, 1]] * 3), axis=-1).reshape(-1, 3) / np.sqrt(3)
        for frame in range(7):
            difference_m = original.track.to_scene(corners, frame) - restored.track.to_scene(corners, frame)
            assert np.linalg.norm(difference_m, axis=1).max() <= PLACE_TOLERANCE_M
    summary = stream.summary()
    assert summary["promise_kept"] and summary["place_tolerance_um"] == pytest.approx(10)
    if damping == 0:  # else velocities are those of the decoded poses, too
        expected = np.stack([error_ratios(scene, decoded, frame) for frame in range(7)])
        assert expected.max() <= 1 and expected.max() == pytest.approx(summary["worst_mask_ratio"], abs=3e-5)
        assert expected[(summary["worst_frame"], *summary["worst_voxel"])] == pytest.approx(
            expected.max(), rel=1e-4
        )
    found, away_m = compare_scenes(scene, decoded, 0.1, F0_N)
    assert found.violations == 0 and away_m <= PLACE_TOLERANCE_M
    assert found.max_error[0] == pytest.approx(summary["worst_mask_ratio"], abs=3e-5)


def test_overlapping_fields_are_coded_finer(tmp_path: Path) -> None:
    scene = crossing()
    alone = replace(scene, objects=scene.objects[:1])
    sizes = {}
    for name, variant in (("together", scene), ("alone", alone)):
        stream = encode_scene(tmp_path / name, variant)
        sizes[name] = len(stream.decoder.objects[0].field)
        assert stream.summary()["worst_mask_ratio"] <= 1
    assert sizes["together"] > sizes["alone"]


def cancelling(strength_n: float, damping: float = 0.0) -> HapticScene:
    """Two fields that cancel: the sum is zero, so errors of a thousandth of 400 N are beyond the bound."""
    field = ball(BODY_GRID, 0.005, strength_n)
    against = ForceField.from_dense(BODY_GRID, -field.to_dense())
    tracks = [PoseTrack.constant(3, (0.0003, 0.0, 0.0)), PoseTrack.constant(3, (0.0003, 0.0, 0.0))]
    bodies = [
        HapticObject(n, single_frame_medium(f), t)
        for n, f, t in zip("ab", (field, against), tracks, strict=True)
    ]
    return HapticScene(WORLD, 1000.0, tuple(bodies), 1000.0, damping)


@pytest.mark.parametrize("f0_n", [0.0, 1e-9, F0_N])
def test_forces_that_cancel_are_sent_exactly(tmp_path: Path, f0_n: float) -> None:
    scene = cancelling(400.0)
    stream = encode_scene(tmp_path / "a.touch", scene, replace(SPEC, f0_n=f0_n))
    summary = stream.summary()
    assert summary["promise_kept"] and summary["worst_mask_ratio"] <= 1
    assert all(not frame.support_count for frame in stream.scene.voxelise())


@pytest.mark.parametrize("deforming", [False, True])
@pytest.mark.parametrize("k", [0.001, 0.1, 0.9])
def test_file_without_f0_satisfies_the_bound(tmp_path: Path, k: float, deforming: bool) -> None:
    """Only k |F| is allowed: bodies that meet, and cells in which the force vanishes."""
    scene = moving_scene(5, deforming)
    scene = replace(scene, objects=(*scene.objects, *crossing(5).objects))
    stream = encode_scene(tmp_path / "a.touch", scene, replace(SPEC, k=k, f0_n=0.0))
    moved = tuple(replace(a, track=b.track) for a, b in zip(scene.objects, stream.scene.objects, strict=True))
    source, decoded = replace(scene, objects=moved).voxelise(), stream.scene.voxelise()
    ratio = max(mask_ratio(a.to_dense(), b.to_dense(), k, 0.0) for a, b in zip(source, decoded, strict=True))
    assert 0.5 < ratio <= 1 + 1e-4 and ratio == pytest.approx(stream.summary()["worst_mask_ratio"], abs=1e-4)


def test_damping_without_f0_satisfies_the_bound(tmp_path: Path) -> None:
    stream = encode_scene(tmp_path / "a.touch", moving_scene(5, False, 2.0), replace(SPEC, f0_n=0.0))
    assert stream.summary()["promise_kept"]


def test_refusal_names_its_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error that remains when every sample is exact comes from the poses."""
    encoder = ObjectsEncoder(moving_scene(5, False, 2.0), replace(SPEC, f0_n=0.0), F0_N)
    monkeypatch.setattr(Pair, "inexact_corners", lambda self, marks: np.zeros(0, np.int64))
    monkeypatch.setattr(ComposedRule, "check", lambda self, pairs, *_: BoundCheck(
        np.full(len(pairs), 2.0), np.zeros((len(pairs), 4), np.int64), 1
    ))  # fmt: skip
    with pytest.raises(InvalidArgument, match=r"damping of 2 N s/m with an F_0 of 0 N.*--f0-n.*voxel"):
        list(encoder.objects())


def test_paper_coder_guarantees_no_bound(tmp_path: Path) -> None:
    stream = encode_scene(tmp_path / "a.touch", moving_scene(), PaperSpec(segment_frames=3))
    assert "promise_kept" not in stream.summary()
    assert stream.decoder.parts(stream.reader.read_segment(0)).max_error is None
    free = encode_scene(tmp_path / "b.touch", moving_scene(), replace(SPEC, mode="nmse"))
    assert free.summary()["mode"] == "nmse" and free.summary()["promise_kept"] is None


def test_lossless_file_has_the_source_at_the_decoded_poses(tmp_path: Path) -> None:
    stream = encode_scene(tmp_path / "a.touch", moving_scene(), replace(SPEC, mode="lossless"))
    assert stream.summary()["worst_mask_ratio"] == 0 and stream.summary()["promise_kept"]


def test_body_at_rest_has_constant_decoded_poses(tmp_path: Path) -> None:
    """Constant poses decode to constant poses, at the start of a segment too."""
    count, moving = 2100, 30  # a segment of rigid bodies has 2048 frames
    motion = tumbling(moving, 0.0021, 0.037)
    rest = [moving - 1] * (count - moving)
    track = PoseTrack(
        np.concatenate([motion.quaternions, -motion.quaternions[rest]]),  # of either sign
        np.concatenate([motion.positions_m, motion.positions_m[rest]]),
    )
    scene = HapticScene(
        WORLD, 1000.0, (HapticObject("ball", single_frame_medium(ball(BODY_GRID, 0.004)), track),), 3.0
    )
    stream = encode_scene(tmp_path / "a.touch", scene)
    assert len(stream.reader.segments) == 2
    (body,) = stream.scene.objects
    assert np.ptp(body.track.positions_m[moving - 1 :], axis=0).max() == 0
    assert np.ptp(body.track.quaternions[moving - 1 :], axis=0).max() == 0
    assert stream.scene.voxelise()[2047] == stream.scene.voxelise()[2048]
    assert displacement_m(track, body.track, 0.006).max() <= PLACE_TOLERANCE_M


@pytest.mark.parametrize("name", ["falling-4", "falling-7"])
def test_falling_bodies_have_no_violations(tmp_path: Path, name: str) -> None:
    pytest.importorskip("mujoco")
    spec = EncodeSpec(nw=5, frames=(240, 270))
    pipeline.encode(f"sample:{name}", tmp_path / "a.touch", spec)
    with pipeline.open_file(tmp_path / "a.touch") as stream:
        summary = stream.summary()
    values = pipeline.compare(f"sample:{name}", tmp_path / "a.touch").summary()
    assert summary["promise_kept"] and values["mask_violations"] == 0
    assert values["worst_mask_ratio"] == pytest.approx(summary["worst_mask_ratio"], abs=3e-5)
    assert values["worst_place_um"] <= values["place_tolerance_um"] == summary["place_tolerance_um"]
