"""The coder `touch` with its own frame models: the promise, every mode, and objects."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from segment_makers import KINDS, field_of

from object_makers import F0_N, moving_scene
from touchfield.codec.objects.decoder import ObjectsDecoder
from touchfield.codec.objects.encoder import ObjectsEncoder
from touchfield.codec.segment import FrameKind
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.promise import compared
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import FormatError
from touchfield.medium import ForceField, Grid
from touchfield.perception.mask import violations

FAST = TouchSpec(effort="fast")
SPECS = tuple(
    replace(FAST, effort=effort, **more)
    for effort in ("fast", "default")
    for more in (
        {},
        {"f0_n": 0.0},
        {"k": 0.25, "support": "exact"},
        {"mode": "mask-direction"},
        {"k": 0.01, "f0_n": 0.001},
    )
)


def round_trip(frames: list[ForceField], spec: TouchSpec) -> tuple[bytes, TouchDecoder, list[ForceField]]:
    encoder = TouchEncoder(frames[0].grid, spec)
    body = encoder.encode_segment(frames).body
    decoder = TouchDecoder(frames[0].grid, encoder.parameters)
    return body, decoder, list(decoder.frames(body, len(frames)))


@settings(max_examples=20)
@given(st.lists(st.sampled_from(KINDS), min_size=1, max_size=2), st.integers(0, 999), st.sampled_from(SPECS))
def test_no_voxel_is_beyond_the_promise(kinds: list[str], seed: int, spec: TouchSpec) -> None:
    frames = [field_of(kind, seed + i) for i, kind in enumerate(kinds)]
    body, decoder, decoded = round_trip(frames, spec)
    for original, made in zip(frames, decoded, strict=True):
        assert not len(compared(original, made, spec).keys)
        if spec.mode == "mask":
            a, b = (f.to_dense().reshape(-1, 3) for f in (original, made))
            assert violations(a, b, spec.k, spec.f0_n).count == 0
    worst = decoder.promise(body).worst_ratio
    assert worst is not None and worst <= 1
    again = round_trip(decoded, spec)[2]
    assert not any(len(compared(a, b, spec).keys) for a, b in zip(decoded, again, strict=True))


def test_most_voxels_need_no_exception(wavy_field: ForceField) -> None:
    frames = [wavy_field, wavy_field.scaled(1.04), wavy_field.scaled(1.1)]
    sizes = {}
    for effort in ("fast", "default"):
        body, decoder, decoded = round_trip(frames, replace(FAST, effort=effort))
        costs = decoder.costs(body, 3)
        assert sum(c.exception_bits for c in costs) < 0.02 * 8 * len(body)
        assert [c.kind for c in costs] == [FrameKind.INTRA, FrameKind.INTER, FrameKind.INTER]
        assert costs[0].bits.support > 0 and costs[0].bits.direction > 0
        assert decoded[0].support_count > 0.8 * wavy_field.support_count
        sizes[effort] = len(body)
    assert sizes["default"] < sizes["fast"]


def test_a_mean_error_is_bought_with_bytes(wavy_field: ForceField) -> None:
    errors, sizes = [], []
    for step in (0.2, 0.05, 0.01):
        body, decoder, (made,) = round_trip([wavy_field], TouchSpec(mode="nmse", step_n=step))
        errors.append(float(((wavy_field.to_dense() - made.to_dense()) ** 2).mean()))
        sizes.append(len(body))
        assert decoder.promise(body).worst is None
    assert errors[0] > 4 * errors[1] > 16 * errors[2] and sizes[0] < sizes[1] < sizes[2]


@pytest.mark.parametrize("kind", KINDS)
def test_lossless_is_exact_to_the_bit(kind: str) -> None:
    spec = TouchSpec(mode="lossless")
    frames = [field_of(kind, 1), field_of(kind, 1), field_of("sparse", 2)]
    body, decoder, decoded = round_trip(frames, spec)
    for a, b in zip(frames, decoded, strict=True):
        assert a.bricks.tobytes() == b.bricks.tobytes() and a.forces_n.tobytes() == b.forces_n.tobytes()
    assert decoder.promise(body).worst_ratio == 0
    assert all(c.model == 3 for c in decoder.costs(body, 3))


def test_damage_is_named(wavy_field: ForceField) -> None:
    frames = [wavy_field, wavy_field.scaled(1.05)]
    rng = np.random.default_rng(3)
    for spec in (FAST, TouchSpec(), TouchSpec(mode="lossless")):
        body, decoder, _ = round_trip(frames, spec)
        for n in rng.integers(0, len(body), 30).tolist():
            with pytest.raises(FormatError):
                list(decoder.frames(body[:n], 2))
        for _ in range(60):
            flipped = bytearray(body)
            flipped[rng.integers(len(body))] ^= 1 << rng.integers(8)
            try:
                list(decoder.frames(bytes(flipped), 2))
            except FormatError:
                continue


def test_threads_share_encoder_and_decoder(wavy_field: ForceField) -> None:
    encoder = TouchEncoder(wavy_field.grid, FAST)
    segments = [[wavy_field.scaled(1 + i / 7), wavy_field.scaled(1 + i / 5)] for i in range(6)]
    alone = [encoder.encode_segment(frames).body for frames in segments]
    made: dict[int, bytes] = {}

    def work(i: int) -> None:
        made[i] = encoder.encode_segment(segments[i]).body

    threads = [threading.Thread(target=work, args=(i,)) for i in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [made[i] for i in range(6)] == alone


def test_grids_of_any_size() -> None:
    for shape in ((1, 1, 1), (32, 32, 1), (1, 9, 40), (200, 3, 3)):
        grid = Grid(shape, (0.001, 0.001, 0.001), (0.0, 0.0, 0.0))
        for kind in ("dense", "constant", "one"):
            original = field_of(kind, 2, grid)
            _, _, (made,) = round_trip([original], FAST)
            assert not len(compared(original, made, FAST).keys)


def test_objects_can_be_coded_by_touch() -> None:
    scene, spec = moving_scene(), replace(FAST, segment_frames=3)
    encoder = ObjectsEncoder(scene, spec, F0_N)
    objects = list(encoder.objects())
    assert {one.field_coder for one in objects} == {"touch"}
    segments = list(encoder.segments())
    decoder = ObjectsDecoder(encoder.parameters, objects)
    for i in (0, 1):
        assert not len(compared(scene.objects[i].field(0), decoder.rigid_field(i), spec).keys)
    for start, count, body in segments:
        for frame, made in zip(range(start, start + count), decoder.fields(body, 2, count), strict=True):
            assert not len(compared(scene.objects[2].field(frame), made, spec).keys)
    told = sum(decoder.object_cost(i).total for i in range(3))
    told += sum(decoder.cost(body, count).total for _, count, body in segments)
    assert told == 8 * (sum(len(one.field) for one in objects) + sum(len(body) for *_, body in segments))
