"""The blend of one segment into the next: smooth for a static source, immediate for a change, none
after a seek.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from player_makers import laid_out, numbered_field, numbered_medium

from touchfield.compute.native import native
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack, Segments
from touchfield.medium.medium import VibrationFrame
from touchfield.render.block import Memory, layout
from touchfield.render.sampler import FieldSampler
from touchfield.render.segment_blend import SegmentBlend, with_blends
from touchfield.render.spec import RenderSpec

GRID = Grid((20, 9, 17), (0.001,) * 3, (0.0,) * 3)
K, F0_N = 0.1, 0.05


def mask_n(forces: np.ndarray) -> np.ndarray:
    return np.maximum(F0_N, K * np.linalg.norm(forces, axis=-1, keepdims=True))


def within(rng: np.random.Generator, source: np.ndarray, fraction: float = 1.0) -> np.ndarray:
    """Forces whose errors are at most this fraction of the mask, some of them exactly."""
    way = rng.normal(size=source.shape)
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    size = fraction * np.minimum(1.0, 1.2 * rng.random((*source.shape[:-1], 1)))
    return (source + 0.9999 * size * mask_n(source) * way).astype(np.float32)


def some_source(rng: np.random.Generator) -> np.ndarray:
    """Strong, weak and zero forces, including empty bricks."""
    dense = rng.normal(size=(*GRID.shape, 3)) * rng.choice([0.0, 0.02, 1.0, 3.0], size=(*GRID.shape, 1))
    dense[:8] = 0
    return dense


def played(frames: list[np.ndarray], rate_hz: float, length: int) -> list[np.ndarray]:
    medium = HapticMedium.from_frames([ForceField.from_dense(GRID, f) for f in frames], rate_hz)
    starts = tuple(range(0, len(frames), length))
    medium, _ = with_blends(replace(medium, segments=Segments(starts, K, F0_N)))
    assert isinstance(medium, HapticMedium)
    return [frame.to_dense() for frame in medium]


def steps(frames: list[np.ndarray]) -> np.ndarray:
    """The largest change from each frame to the next over all voxels."""
    return np.linalg.norm(np.diff(np.stack(frames), axis=0), axis=-1).reshape(len(frames) - 1, -1).max(axis=1)


@pytest.mark.parametrize(("rate_hz", "length", "max_step"), [(30.0, 8, 0.51), (1000.0, 64, 0.06)])
def test_a_segment_of_a_static_source_starts_without_a_step(
    rate_hz: float, length: int, max_step: float
) -> None:
    rng = np.random.default_rng(4)
    source = some_source(rng)
    of_segment = [within(rng, source, 0.8) for _ in range(3)]
    frames = [
        of_segment[n // length] + 0.1 * (within(rng, source) - source).astype(np.float32)
        for n in range(3 * length)
    ]
    got = played(frames, rate_hz, length)
    at_start = np.arange(1, 3 * length) % length == 0
    jump, noise = steps(frames)[at_start].max(), steps(frames)[~at_start].max()
    assert jump > 2 * noise
    assert steps(got).max() < max_step * jump + noise
    assert steps(got)[at_start].max() < (0.26 if rate_hz == 30 else 0.01) * jump + noise
    for frame, decoded in zip(got, frames):
        assert (np.linalg.norm(frame - source, axis=-1, keepdims=True) <= mask_n(source) * (1 + 1e-6)).all()
        assert frame.shape == decoded.shape
    for n in range(length):  # the first segment has no predecessor; the second half of each is as decoded
        np.testing.assert_array_equal(got[n], frames[n])
        if n >= length // 2:
            np.testing.assert_array_equal(got[length + n], frames[length + n])


@given(st.integers(0, 2**32 - 1), st.integers(3, 30), st.sampled_from([25.0, 100.0, 1000.0]))
def test_a_blend_of_two_fields_within_the_mask_stays_within_it(
    seed: int, length: int, rate_hz: float
) -> None:
    rng = np.random.default_rng(seed)
    source = some_source(rng)
    frames = [within(rng, source)] * length + [within(rng, source)] * length
    for frame in played(frames, rate_hz, length):
        assert (np.linalg.norm(frame - source, axis=-1, keepdims=True) <= mask_n(source) * (1 + 1e-6)).all()


def test_a_changed_source_is_not_blended() -> None:
    before = np.zeros((*GRID.shape, 3), np.float32)
    before[:4, ..., 2] = 1.0  # goes
    before[8:12, ..., 2] = 1.0  # turns
    before[12:16, ..., 2] = 1.0  # changes by less than both masks
    before[16:, ..., 2] = 0.04  # goes, and may have been zero
    after = np.zeros_like(before)
    after[4:8, ..., 0] = 1.0  # comes
    after[8:12, ..., 2] = -1.0
    after[12:16, ..., 2] = 1.18
    got = played([before] * 8 + [after] * 16, 1000.0, 8)
    np.testing.assert_array_equal(got[8][:12], after[:12])
    weight = 0.5 - 0.5 * np.cos(np.pi / 4)
    np.testing.assert_allclose(got[8][12:16, ..., 2], 1 + 0.18 * weight, rtol=1e-6)
    np.testing.assert_allclose(got[8][16:, ..., 2], 0.04 * (1 - weight), rtol=1e-6)
    np.testing.assert_array_equal(got[11], after)


def test_equal_frames_stay_equal() -> None:
    source = some_source(np.random.default_rng(1)).astype(np.float32)
    assert steps(played([source] * 24, 30.0, 8)).max() == 0


@pytest.mark.parametrize(("rate_hz", "length"), [(20.0, 8), (1000.0, 2), (1000.0, 1)])
def test_slow_media_and_short_segments_are_not_blended(rate_hz: float, length: int) -> None:
    rng = np.random.default_rng(2)
    source = some_source(rng)
    frames = [within(rng, source) for _ in range(8)]
    for blended, decoded in zip(played(frames, rate_hz, length)[: 8 if rate_hz == 20 else -length], frames):
        np.testing.assert_array_equal(blended, decoded)


def test_a_last_segment_of_one_frame_continues_the_previous_one() -> None:
    rng = np.random.default_rng(2)
    source = some_source(rng)
    got = played([within(rng, source)] * 8 + [within(rng, source)], 1000.0, 8)
    assert 0 < steps(got)[-1] < 0.001


SEGMENTED = replace(numbered_medium(30, 1000.0), segments=Segments((0, 10, 20), 0.1, 0.05))
"""Each frame adds 1/64 N; a blend takes four frames of the second segment."""


def blended_z(frame: int) -> float:
    """The force of a frame of the second segment, blended with the last of the first."""
    weight = 0.5 - 0.5 * np.cos(np.pi * min(1.0, (frame - 9) / 5))
    return 0.5 + (9 + weight * (frame - 9)) / 64


def frame_offset(memory: Memory, frame: int) -> int:
    """Where the directory says that a frame is."""
    slots, offset = (int(memory.receiver["layout"][f"directory_{name}"]) for name in ("slots", "offset"))
    return int(memory.array(layout.DIRECTORY_ENTRY, offset, slots)["frame_offset"][frame % slots])


def need(memory: Memory, generation: int, frame: int) -> None:
    """Let the servo need a frame of a generation."""
    memory.receiver["clock"]["needs"] = (generation << layout.FRAME_BITS) | frame


def in_order(medium: HapticMedium, spec: RenderSpec | None = None, **options: object):
    """A feeder, and a function for the force along z of a written frame."""
    session, memory = laid_out(medium, spec, **options)
    feeder = session.feeder(memory)

    def z_of(frame: int) -> float:
        offset = frame_offset(memory, frame)
        return native.force_at(memory.bytes, offset, offset, 0.0, 0.0, 0.0, 0.0)[2]

    return feeder, memory, z_of


def unblended_z(frame: int) -> float:
    return 0.5 + frame / 64


def test_continuous_play_is_blended_and_a_seek_is_not() -> None:
    feeder, memory, z_of = in_order(SEGMENTED)
    feeder.fill_lookahead(20)
    for n in range(20):
        assert z_of(n) == pytest.approx(blended_z(n) if 10 <= n < 14 else unblended_z(n), abs=1e-6)
    assert z_of(10) < unblended_z(10) - 0.01
    for generation, first in ((2, 10), (3, 12), (4, 9)):
        feeder.seek(generation, first)
        need(memory, generation, first)
        while feeder.step():
            pass
        for n in range(first, 20):
            follows = first == 9 and 10 <= n < 14
            assert z_of(n) == pytest.approx(blended_z(n) if follows else unblended_z(n), abs=1e-6)


def test_a_seek_to_the_next_segment_is_not_blended() -> None:
    feeder, memory, z_of = in_order(SEGMENTED)
    feeder.fill_lookahead(10)
    feeder.seek(2, 10)
    need(memory, 2, 10)
    assert feeder.step() and z_of(10) == unblended_z(10)


def test_a_loop_is_blended_into_its_start() -> None:
    slow_ramp = replace(SEGMENTED, make_frame=lambda n: numbered_field(n % 10 // 2))
    feeder, _, z_of = in_order(slow_ramp, loop=True)
    feeder.fill_lookahead(35)
    assert z_of(0) == 0.5 and z_of(30) == pytest.approx(
        0.5 + 4 / 64 * (0.5 + 0.5 * np.cos(np.pi / 5)), abs=1e-6
    )


def test_blending_can_be_disabled() -> None:
    feeder, _, z_of = in_order(SEGMENTED, RenderSpec(blend=False))
    feeder.fill_lookahead(20)
    assert [z_of(n) for n in range(20)] == [unblended_z(n) for n in range(20)]


def test_the_medium_and_its_queries_are_not_blended() -> None:
    feeder, _, _ = in_order(SEGMENTED)
    feeder.fill_lookahead(20)
    sampler = FieldSampler(SEGMENTED)
    for n in (9, 10, 11):
        assert SEGMENTED[n] == numbered_field(n)
        assert sampler.force_n(n / 1000, np.zeros(3))[2] == unblended_z(n)


def test_vibration_is_not_blended() -> None:
    def hum(n: int) -> VibrationFrame:
        indices = np.argwhere(np.ones(SEGMENTED.grid.shape, bool)).astype(np.int32)
        amplitudes, frequencies = (np.full(len(indices), v, np.float32) for v in (0.1 + n / 100, 100 + n))
        return VibrationFrame(SEGMENTED.grid, indices, amplitudes, frequencies)

    medium = replace(SEGMENTED, vibration=hum)
    session, memory = laid_out(medium)
    session.feeder(memory).fill_lookahead(20)
    for n in range(20):
        offset = frame_offset(memory, n)
        found = native.vibration_at(memory.bytes, offset, offset, 0.0, 0.0, 0.0, 0.0)
        np.testing.assert_allclose(found, [0.1 + n / 100, 100 + n], rtol=1e-5)


def test_only_deforming_bodies_are_blended() -> None:
    rigid = HapticObject("rigid", numbered_medium(1), PoseTrack.constant(30))
    scene = HapticScene(SEGMENTED.grid, 1000.0, (rigid,), 4.0)
    slow = replace(SEGMENTED, rate_hz=20.0)  # whose frames are 50 ms apart
    assert with_blends(scene) == (scene, ()) and with_blends(slow) == (slow, ())
    soft = HapticObject("soft", SEGMENTED, PoseTrack.constant(30))
    both, blends = with_blends(replace(scene, objects=(rigid, soft)))
    assert isinstance(both, HapticScene) and both.objects[0] is not rigid and len(blends) == 1
    found = [both.objects[1].field(n).to_dense()[3, 3, 3, 2] for n in range(20)]
    assert found[10] == pytest.approx(blended_z(10), abs=1e-6) and found[19] == unblended_z(19)
    assert both.objects[1].field(19).to_dense()[3, 3, 3, 2] == found[19]  # a second query


def test_segments_of_a_part_are_counted_from_its_start() -> None:
    segments = Segments((0, 8, 16, 24), 0.1, 0.05)
    assert segments.segment_at(8, 30) == (8, 8) and segments.segment_at(29, 30) == (24, 6)
    assert segments.between(8, 20).starts == (0, 8) and segments.between(9, 17).starts == (0, 7)
    medium = replace(numbered_medium(30), segments=segments).between(9, 17)
    assert SegmentBlend(medium, medium.segments or segments)(3) == numbered_field(12)
    for starts in ((), (1, 2), (0, 4, 4)):
        with pytest.raises(InvalidArgument):
            Segments(starts, 0.1, 0.05)
