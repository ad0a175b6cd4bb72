"""The laws of all efforts: they change the bytes, never the promise; with the frame models as they are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from segment_makers import KINDS, field_of

from touchfield.codec.touch.body import GuessKind
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.promise import compared
from touchfield.codec.touch.spec import EFFORTS, TouchSpec
from touchfield.codec.touch.ways import may_be_solid
from touchfield.job import EncodeSpec, prepare
from touchfield.medium import ForceField, Grid
from touchfield.perception.mask import violations
from touchfield.sources.options import SourceOptions

SMALL = Grid((11, 9, 10), (0.001, 0.002, 0.0015), (0.0, 0.0, 0.0))
RULES: tuple[dict[str, Any], ...] = (
    {},
    {"f0_n": 0.0, "k": 0.02},
    {"support": "exact", "k": 0.25},
    {"mode": "mask-direction"},
)


def round_trip(frames: list[ForceField], spec: TouchSpec) -> tuple[bytes, TouchDecoder, list[ForceField]]:
    encoder = TouchEncoder(frames[0].grid, spec)
    body = encoder.encode_segment(frames).body
    decoder = TouchDecoder(frames[0].grid, encoder.parameters)
    return body, decoder, list(decoder.frames(body, len(frames)))


def beyond(frames: list[ForceField], decoded: list[ForceField], spec: TouchSpec) -> int:
    count = 0
    for original, made in zip(frames, decoded, strict=True):
        count += len(compared(original, made, spec).keys)
        if spec.mode == "mask":
            a, b = (f.to_dense().reshape(-1, 3) for f in (original, made))
            count += violations(a, b, spec.k, spec.f0_n).count
    return count


def hills(depth: int, wall: int | None = None, lift: float = 0.0) -> ForceField:
    """A penalty field behind a wavy surface, towards -z; a wall of some voxels, or all that is behind."""
    grid = Grid((40, 33, depth), (0.001, 0.001, 0.0007), (0.0, 0.0, 0.0))
    x, y, z = np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij")
    top = 9 + lift + 3 * np.sin(x / 6) * np.cos(y / 7)
    inside = z - top
    held = (inside > 0) & (True if wall is None else inside < wall)
    forces = np.zeros((*grid.shape, 3), np.float32)
    forces[..., 2] = -np.where(held, np.minimum(0.35 * inside, 3.3), 0)
    forces[..., 0] = np.where(held, 0.2 * forces[..., 2] * np.cos(x / 6), 0)
    return ForceField.from_dense(grid, forces)


@pytest.mark.parametrize("effort", EFFORTS)
@settings(max_examples=4)
@given(
    kinds=st.lists(st.sampled_from(KINDS), min_size=1, max_size=2),
    seed=st.integers(0, 999),
    rule=st.sampled_from(RULES),
)
def test_no_voxel_is_beyond_the_promise(effort: str, kinds: list[str], seed: int, rule: dict[str, Any]) -> None:
    spec = replace(TouchSpec(effort=effort), **rule)
    frames = [field_of(kind, seed + i, SMALL) for i, kind in enumerate(kinds)]
    body, decoder, decoded = round_trip(frames, spec)
    assert beyond(frames, decoded, spec) == 0
    worst = decoder.promise(body).worst_ratio
    assert worst is not None and worst <= 1


def test_effort_changes_the_bytes_and_not_the_promise() -> None:
    frames = [hills(32, lift=0.7 * i) for i in range(3)]
    bodies, promises = {}, {}
    for effort in EFFORTS:
        spec = TouchSpec(effort=effort)
        body, decoder, decoded = round_trip(frames, spec)
        assert beyond(frames, decoded, spec) == 0
        bodies[effort], promise = body, decoder.promise(body)
        assert promise.worst is not None and promise.worst.ratio <= 1
        promises[effort] = replace(promise, worst=None)
    assert len(bodies["max"]) <= len(bodies["default"]) < len(bodies["fast"])
    assert promises["fast"] == promises["default"] == promises["max"]


@pytest.mark.parametrize("effort", EFFORTS)
def test_segments_in_any_order(effort: str) -> None:
    """What is learnt within a segment ends with it, in encoder and decoder."""
    segments = [[hills(24, 5, 0.4 * i + j) for j in range(2)] for i in range(3)]
    encoder = TouchEncoder(segments[0][0].grid, TouchSpec(effort=effort))
    forth = [encoder.encode_segment(frames).body for frames in segments]
    assert [encoder.encode_segment(frames).body for frames in reversed(segments)] == forth[::-1]
    decoder = TouchDecoder(segments[0][0].grid, encoder.parameters)
    there = [list(decoder.frames(body, 2)) for body in forth]
    assert {i: list(decoder.frames(forth[i], 2)) for i in (2, 0, 1)} == dict(enumerate(there))


def test_what_the_heavy_model_learns_makes_the_next_frames_smaller(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    frames = []
    for i in range(3):
        rough = hills(24, 3, 0.3 * i).to_dense()
        rough += np.where(rough != 0, rng.normal(0, 0.15, rough.shape), 0).astype(np.float32)
        frames.append(ForceField.from_dense(hills(24).grid, rough))
    spec = TouchSpec(effort="max", motion="off", interframe="on")
    with_memory = round_trip(frames, spec)[0]

    monkeypatch.setattr("touchfield.codec.touch.choice.Chooser._memory", lambda *_: None)
    encoder = TouchEncoder(frames[0].grid, spec)
    with pytest.raises(AssertionError):  # the decoder remembers: the encoder must not forget alone
        encoder.encode_segment(frames)
    monkeypatch.setattr("touchfield.codec.touch.decoder._memory", lambda *_: None)
    assert len(with_memory) < len(encoder.encode_segment(frames).body)


@pytest.mark.parametrize("effort", EFFORTS)
def test_a_solid_is_told_by_its_surface(effort: str) -> None:
    solid, wall = hills(40), hills(40, 5)
    assert may_be_solid(solid) and not may_be_solid(wall)
    sizes = []
    for asked in ("auto", "off"):
        spec = TouchSpec(effort=effort, surface=asked)
        body, decoder, decoded = round_trip([solid], spec)
        assert beyond([solid], decoded, spec) == 0
        (cost,) = decoder.costs(body, 1)
        assert (cost.guess == GuessKind.SURFACE) == (cost.bits.models > 0) == (asked == "auto")
        sizes.append(len(body))
    assert sizes[0] < sizes[1]
    body, decoder, _ = round_trip([solid, solid], TouchSpec(effort=effort))
    first, second = decoder.costs(body, 2)  # a standing surface is not told again
    assert second.bits.models == 0 and second.bits.total < 0.3 * first.bits.total


def test_nothing_is_solid_in_an_empty_field() -> None:
    assert not may_be_solid(ForceField.empty(SMALL))


@pytest.fixture(scope="module")
def real(shared_data: Path) -> dict[tuple[str, str], list[ForceField]]:
    """Two frames of each real sequence, as bands and as height fields."""
    made = {}
    for name in ("rgbd_tum_fr1_rpy", "rgbd_iclnuim_livingroom1"):
        for reading in ("band", "height"):
            source = SourceOptions() if reading == "band" else SourceOptions(reading="height")
            spec = EncodeSpec(nw=6, frames=(0, 2), source=source)
            made[name, reading] = list(prepare(shared_data / name, spec).medium)
    return made


@pytest.mark.shared
@pytest.mark.parametrize("effort", EFFORTS)
@pytest.mark.parametrize("k", [0.05, 0.1, 0.25])
def test_real_fields_keep_the_promise(real: dict[tuple[str, str], list[ForceField]], effort: str, k: float) -> None:
    for (name, reading), frames in real.items():
        if effort == "max" and (k != 0.1 or "icl" in name or reading == "band"):
            continue
        spec = TouchSpec(effort=effort, k=k)
        assert beyond(frames, round_trip(frames, spec)[2], spec) == 0, (name, reading)
