"""Segments: intra and inter frames, independence of segments, and shared key frames."""

from __future__ import annotations

import math
import threading
from dataclasses import replace

import numpy as np
import pytest
from bound import error_ratios
from field_makers import GRID, KINDS, field_of, hills, round_trip
from hypothesis import given, settings, strategies as st
from native_model import bit_fractions

from touchfield.codec.registry import coder, field_decoder
from touchfield.codec.segment import FrameKind, MaxError, max_error_keys
from touchfield.codec.touch.body import (
    BodyReader,
    FrameRecord,
    Lattice,
    write_body,
)
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.codec.varint import write_varint
from touchfield.errors import CorruptFile, InvalidArgument, UnsupportedVersion
from touchfield.medium import ForceField, Grid

FAST = TouchSpec(effort="fast")
SPECS = (
    TouchSpec(),
    replace(FAST, f0_n=0.0),
    replace(FAST, mode="mask-direction"),
    TouchSpec(mode="nmse", step_n=0.3),
    TouchSpec(mode="nmse", step_n=0.02, support="exact"),
    TouchSpec(mode="lossless"),
    TouchSpec(masking=0.1, masking_radius_m=0.003),
)


def kinds_of(body: bytes, decoder: TouchDecoder, count: int) -> list[FrameKind]:
    return [cost.kind for cost in decoder.costs(body, count)]


def test_frame_is_inter_coded_where_that_is_smaller() -> None:
    frames = [hills(24, 5, 0.05 * i) for i in range(3)] + [hills(24, 5, 8.0)]
    body, decoder, decoded = round_trip(frames, TouchSpec())
    costs = decoder.costs(body, 4)
    assert [c.kind for c in costs][:3] == [FrameKind.INTRA, FrameKind.INTER, FrameKind.INTER]
    intra_body, intra_decoder, _ = round_trip(frames, TouchSpec(interframe="off"))
    assert len(body) < len(intra_body) and set(kinds_of(intra_body, intra_decoder, 4)) == {FrameKind.INTRA}
    inter_body, inter_decoder, _ = round_trip(frames, TouchSpec(interframe="on"))
    assert kinds_of(inter_body, inter_decoder, 4) == [FrameKind.INTRA] + 3 * [FrameKind.INTER]
    # bits by kind, with and without decoding, equal the encoder's
    segment = TouchEncoder(frames[0].grid, TouchSpec()).encode_segment(frames)
    assert [c.bits for c in costs] == [s.bits for s in segment.frames]
    assert [c.kind for c in costs] == [s.kind for s in segment.frames]
    assert [s.supported for s in segment.frames] == [f.support_count for f in decoded]
    assert 0 < 8 * len(body) - sum(c.bits.total for c in costs) < 8 * 40
    assert costs[0].bits.support > 0 and costs[0].bits.amplitude > 0 and costs[0].bits.direction > 0


def test_most_voxels_are_not_outliers(wavy_field: ForceField) -> None:
    frames = [wavy_field, wavy_field.scaled(1.04), wavy_field.scaled(1.1)]
    body, _, decoded = round_trip(frames, TouchSpec())
    assert decoded[0].support_count > 0.8 * wavy_field.support_count
    records = BodyReader(body, wavy_field.grid, exact=False).records(3)
    assert sum(len(record.outliers) for record in records) < 0.02 * len(body)


@pytest.mark.parametrize("axis", range(3))
def test_outliers_must_be_inside_the_grid(axis: int) -> None:
    shape = [24, 24, 24]
    shape[axis] = 19
    grid = Grid((shape[0], shape[1], shape[2]), (0.001,) * 3, (0.0,) * 3)
    for last, is_inside in ((18, True), (19, False)):
        dense = np.zeros((24, 24, 24, 3), np.float32)
        at = [17, 17, 17]
        at[axis] = last
        dense[tuple(at)] = 1, 2, 3
        sample = 0
        for c in at:
            sample = sample << 3 | c & 7
        encoder, empty = TouchEncoder(grid, FAST), ForceField.empty(grid)
        reader = BodyReader(encoder.encode_segment([empty], longest_n=1.0).body, grid, exact=False)
        (record,) = reader.records(1)
        outlier = write_varint(2 * 9 + 2 * 3 + 2) + write_varint(2 * sample) + np.float32([1, 2, 3]).tobytes()
        body = write_body(reader.lattice, [replace(record, outliers=outlier)], None)
        decoded = TouchDecoder(grid, encoder.parameters).frames(body, 1)
        if is_inside:
            inner = tuple(slice(n) for n in grid.shape)
            assert list(decoded) == [ForceField.from_dense(grid, dense[inner])]
        else:
            with pytest.raises(CorruptFile, match="beyond the grid"):
                list(decoded)


@pytest.mark.parametrize("effort", ["fast", "default"])
def test_segments_are_independent(effort: str) -> None:
    """Adapted state ends with its segment in encoder and decoder, so segments may come in any order."""
    segments = [[hills(17, 5, 0.4 * i + j) for j in range(2)] for i in range(3)]
    encoder = TouchEncoder(segments[0][0].grid, TouchSpec(effort=effort))
    bodies = [encoder.encode_segment(frames).body for frames in segments]
    assert [encoder.encode_segment(frames).body for frames in reversed(segments)] == bodies[::-1]
    decoder = TouchDecoder(segments[0][0].grid, encoder.parameters)
    expected = [list(decoder.frames(body, 2)) for body in bodies]
    assert {i: list(decoder.frames(bodies[i], 2)) for i in (2, 0, 1)} == dict(enumerate(expected))


def test_threads_share_encoder_and_decoder(wavy_field: ForceField) -> None:
    encoder = TouchEncoder(wavy_field.grid, FAST)
    segments = [[wavy_field.scaled(1 + i / 7), wavy_field.scaled(1 + i / 5)] for i in range(6)]
    expected = [encoder.encode_segment(frames).body for frames in segments]
    bodies: dict[int, bytes] = {}

    def work(i: int) -> None:
        bodies[i] = encoder.encode_segment(segments[i]).body

    threads = [threading.Thread(target=work, args=(i,)) for i in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [bodies[i] for i in range(6)] == expected


def test_segments_that_share_a_key_frame_start_with_the_same_payload() -> None:
    """A static scene with some noise: the first frame of each segment has the same payload."""
    spec, world = TouchSpec(), hills(24, 5)
    rng = np.random.default_rng(1)
    segments = []
    for _ in range(3):
        noisy = world.forces_n * (1 + rng.normal(0, 0.01, world.forces_n.shape).astype(np.float32))
        segments.append([ForceField(world.grid, world.bricks, noisy), world])
    encoder = TouchEncoder(world.grid, spec)
    key_frame = world.scaled(1.2)  # longer than every force: each segment has its own unit
    bodies = [encoder.encode_segment(frames, key_frame).body for frames in segments]
    decoder = TouchDecoder(world.grid, encoder.parameters)
    for frames, body in zip(segments, bodies, strict=True):
        for original, restored in zip(frames, decoder.frames(body, 2), strict=True):
            assert error_ratios(original, restored, spec).max() <= 1
    first_records = [BodyReader(body, world.grid, exact=False).records(2)[0] for body in bodies]
    assert first_records[0].payload == first_records[1].payload == first_records[2].payload
    with pytest.raises(InvalidArgument, match="grid"):
        encoder.encode_segment([world], field_of("one", 1))


@settings(max_examples=15)
@given(st.sampled_from(KINDS), st.integers(0, 999), st.sampled_from(SPECS))
def test_decoded_fields_can_be_coded_again(kind: str, seed: int, spec: TouchSpec) -> None:
    once = round_trip([field_of(kind, seed)], spec)[2]
    body, _, twice = round_trip(once, spec)
    assert error_ratios(once[0], twice[0], spec).max(initial=0) <= 1 + 1e-12
    assert round_trip(once, spec)[0] == body  # equal fields, equal bytes


def test_smaller_mean_error_takes_more_bytes(wavy_field: ForceField) -> None:
    errors, sizes = [], []
    for step in (0.2, 0.05, 0.01):
        body, decoder, (restored,) = round_trip([wavy_field], TouchSpec(mode="nmse", step_n=step))
        errors.append(float(((wavy_field.to_dense() - restored.to_dense()) ** 2).mean()))
        sizes.append(len(body))
        assert decoder.max_error(body) is None
    assert errors[0] > 4 * errors[1] > 16 * errors[2] and sizes[0] < sizes[1] < sizes[2]


@pytest.mark.parametrize("kind", KINDS)
def test_lossless_is_exact_to_the_bit(kind: str) -> None:
    frames = [field_of(kind, 1), field_of(kind, 1), field_of("sparse", 2)]
    body, decoder, decoded = round_trip(frames, TouchSpec(mode="lossless"))
    for a, b in zip(frames, decoded, strict=True):
        assert a.bricks.tobytes() == b.bricks.tobytes() and a.forces_n.tobytes() == b.forces_n.tobytes()
    worst = decoder.max_error(body)
    assert worst is not None and worst.ratio == 0


def test_fields_that_cannot_be_coded_are_refused_by_name() -> None:
    good = field_of("sparse", 1)
    for invalid, message in ((np.nan, "nan"), (np.inf, "inf"), (-np.inf, "inf"), (3e38, "3e\\+38")):
        forces = np.array(good.forces_n)
        forces[0, 1, 2, 3, 1] = invalid
        with pytest.raises(InvalidArgument, match=f"frame 1.*{message}"):
            TouchEncoder(GRID, FAST).encode_segment([good, ForceField(GRID, good.bricks, forces)])
    other = Grid((8, 8, 8), (1, 1, 1), (0, 0, 0))
    with pytest.raises(InvalidArgument, match="grid"):
        TouchEncoder(GRID, FAST).encode_segment([ForceField.empty(other)])


@pytest.mark.parametrize("spec", SPECS)
def test_parameters_round_trip_the_options(spec: TouchSpec) -> None:
    parameters = TouchEncoder(GRID, spec).parameters
    read = TouchDecoder(GRID, parameters).spec
    used = {"mask": ("k", "f0_n"), "mask-direction": ("k", "f0_n", "direction_jnd_deg"), "nmse": ("step_n",)}
    for name in ("mode", "support", "effort", "masking", "masking_radius_m", *used.get(spec.mode, ())):
        assert getattr(read, name) == getattr(spec, name)
    assert TouchDecoder(GRID, parameters).describe()["mode"] == spec.mode
    for n in range(len(parameters)):
        with pytest.raises(CorruptFile, match="HEAD"):
            TouchDecoder(GRID, parameters[:n])
    with pytest.raises(UnsupportedVersion):
        TouchDecoder(GRID, b"\2" + parameters[1:])
    for bad in (
        parameters + b"\0",
        bytes([1, 24, *parameters[2:]]),
        bytes([1, parameters[1] ^ 32, *parameters[2:]]),
    ):
        with pytest.raises(CorruptFile):
            TouchDecoder(GRID, bad)
    if spec.masking:
        none = parameters[:-16] + bytes(8) + parameters[-8:]
        with pytest.raises(CorruptFile, match="masking with a fraction of 0"):
            TouchDecoder(GRID, none)
    if len(parameters) > 2:
        with pytest.raises(CorruptFile):
            TouchDecoder(GRID, parameters[:-8] + np.float64(-np.inf).tobytes())


def test_obsolete_efforts_are_read() -> None:
    body, _, frames = round_trip([field_of("dense", 3)], TouchSpec())
    parameters = TouchEncoder(GRID, TouchSpec()).parameters
    former = TouchDecoder(GRID, bytes([1, 2 << 3, *parameters[2:]]))
    assert former.spec == TouchDecoder(GRID, parameters).spec
    assert list(former.frames(body, 1)) == frames
    with pytest.raises(InvalidArgument, match="effort: found 'max'"):
        TouchSpec(effort="max")


def test_max_error_is_not_rounded_down() -> None:
    lattice = Lattice(1.0, 100, 0, 100, 0)
    for ratio in (0.0, 1e-9, 0.5, 0.99999, 1.0):
        read = BodyReader(write_body(lattice, [], MaxError(ratio, 0, (0, 0, 0))), GRID, exact=False).max_error
        assert read is not None and ratio <= read.ratio <= ratio + 1 / 65535


def test_max_error_of_a_file_names_its_frame() -> None:
    max_errors = [
        (0, MaxError(0.5, 2, (1, 2, 3))),
        (8, MaxError(0.75, 1, (4, 5, 6))),
        (24, MaxError(0.75, 0, (0, 0, 0))),
    ]
    expected = {"promise_kept": True, "worst_mask_ratio": 0.75, "worst_frame": 9, "worst_voxel": [4, 5, 6]}
    assert max_error_keys(max_errors) == expected
    assert set(max_error_keys([(0, None)]).values()) == {None}


def test_the_registry_knows_the_coder() -> None:
    assert coder("touch").decoder_class is TouchDecoder
    assert isinstance(
        field_decoder("touch", GRID, TouchEncoder(GRID, FAST).parameters, "OBJT 0"), TouchDecoder
    )
    with pytest.raises(CorruptFile, match="OBJT 7 field_parameters"):
        field_decoder("touch", GRID, b"", "OBJT 7")


def test_fractions_are_multiples_of_1_255() -> None:
    assert bit_fractions((0.0, 0.0, 0.0)) == (255, 0)
    assert bit_fractions((1.0, 1.0, 0.0)) == (128, 127)
    assert bit_fractions((0.0, 0.0, 5.0)) == (0, 0)
    rng = np.random.default_rng(1)
    for bits in rng.random((100, 3)):
        support, amplitude = bit_fractions((bits[0], bits[1], bits[2]))
        assert np.abs(np.array([support, amplitude]) / 255 - bits[:2] / bits.sum()).max() <= 1 / 255
        assert min(support, amplitude) >= 0 and support + amplitude <= 255


@pytest.mark.parametrize(
    ("bits", "fractions"),
    [
        ((-8.0, 10.0, 6.0), (0, 255)),  # a negative cost, as costs are estimates
        ((20.0, -3.0, -9.0), (255, 0)),
        ((3.0, -5.0, 10.0), (96, 0)),
        ((-1e9, 1e9, 1.0), (0, 255)),
        ((math.inf, 1.0, 1.0), (255, 0)),
        ((math.nan, 1.0, 1.0), (255, 0)),
        ((-5.0, 2.0, 1.0), (255, 0)),
    ],
)
def test_fractions_saturate(bits: tuple[float, float, float], fractions: tuple[int, int]) -> None:
    assert bit_fractions(bits) == fractions
    record = FrameRecord(False, b"", b"payload", fractions)
    parts = write_body(None, [record], None)
    assert BodyReader(parts, GRID, exact=True).records(1)[0].fractions == fractions
