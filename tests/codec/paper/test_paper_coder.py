"""The paper's coder: its error bound, its cost in bits, and its errors on damaged bodies."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from touchfield.codec.paper.body import BodyReader
from touchfield.codec.paper.decoder import PaperDecoder
from touchfield.codec.paper.directions import Codebook
from touchfield.codec.paper.encoder import PaperEncoder
from touchfield.codec.paper.spec import PaperSpec
from touchfield.errors import FormatError, InvalidArgument
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField, Grid
from touchfield.medium.field import brick_keys


def moving_sheet(frames: int, noise_n: float = 0.0, speed: float = 0.0, seed: int = 3) -> list[ForceField]:
    """A wavy wall, 5 samples thick, with optional sensor noise and motion, up to 3.3 N."""
    rng = np.random.default_rng(seed)
    grid = Grid((40, 36, 30), (0.004, 0.004, 0.004), (0.0, 0.0, 0.0))
    x, y, z = np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij")
    fields = []
    for t in range(frames):
        depth = z - (12 + 5 * np.sin((x + speed * t) / 6) * np.cos(y / 7))
        amplitude = np.where((depth > 0) & (depth < 5), 3.3 * depth / 5, 0)
        slope = np.stack([np.cos((x + speed * t) / 6), np.sin(y / 7), np.full(x.shape, -2.0)], axis=-1)
        normal = slope / np.linalg.norm(slope, axis=-1, keepdims=True)
        force = amplitude[..., None] * normal
        force += noise_n * rng.normal(size=force.shape) * (amplitude > 0)[..., None]
        fields.append(ForceField.from_dense(grid, force.astype(np.float32)))
    return fields


def encode_and_decode(
    frames: list[ForceField], spec: PaperSpec
) -> tuple[bytes, list[ForceField], PaperDecoder]:
    encoder = PaperEncoder(frames[0].grid, spec)
    segment = encoder.encode_segment(frames)
    assert [frame_record.supported for frame_record in segment.frames[:1]] == [frames[0].support_count]
    decoder = PaperDecoder(frames[0].grid, encoder.parameters)
    costs = decoder.costs(segment.body, len(frames))
    assert [(c.kind, c.bits) for c in costs] == [
        (frame_record.kind, frame_record.bits) for frame_record in segment.frames
    ]
    return segment.body, list(decoder.frames(segment.body, len(frames))), decoder


def nmse_db(frames: list[ForceField], decoded: list[ForceField]) -> float:
    meter = FidelityMeter(0.1, 0.05)
    for a, b in zip(frames, decoded, strict=True):
        meter.add(a, b)
    assert meter.nmse_db is not None
    return meter.nmse_db


SPECS = {
    "default": PaperSpec(),
    "alone": PaperSpec(interframe="none"),
    "weber": PaperSpec(amplitude="weber"),
    "uniform": PaperSpec(amplitude="uniform"),
    "no-deadband": PaperSpec(deadband="none", directions="octa3"),
    "last-sent": PaperSpec(deadband="last-sent", directions="ico3"),
    "literal": PaperSpec.literal(),
    "zero-in-place": PaperSpec.literal(deadband="zero"),
}


@pytest.mark.parametrize("spec", SPECS.values(), ids=SPECS)
def test_support_and_bits_of_every_setting(spec: PaperSpec) -> None:
    frames = moving_sheet(3, noise_n=0.02, speed=0.3)
    body, decoded, decoder = encode_and_decode(frames, spec)
    for original, restored in zip(frames, decoded, strict=True):
        positions, original_positions = (
            {tuple(p) for p in f.positions().tolist()} for f in (restored, original)
        )
        if spec.interframe != "open" and spec.amplitude == "lloyd-max":
            assert positions == original_positions
        elif spec.interframe != "open":
            assert positions <= original_positions, (
                "a ladder with a zero level may silence a voxel, never wake one"
            )
    total = sum(c.bits.total for c in decoder.costs(body, len(frames)))
    assert 0 < 8 * len(body) - total <= 8 * 1500, "what the frames do not cost is tables"
    assert nmse_db(frames, decoded) < -3


@pytest.mark.parametrize("noise_n", [0.0, 0.05])
def test_held_voxels_are_within_k(noise_n: float) -> None:
    """A voxel held by the deadband is within k of the original in every frame, whatever the quantisers do."""
    frames = moving_sheet(6, noise_n)
    for k in (0.05, 0.25):
        body, decoded, _ = encode_and_decode(frames, PaperSpec(k=k, choose_by_size=False))
        reader = BodyReader(body, frames[0].grid, Codebook.get("ico5"))
        read = [reader.symbols(parts) for parts, _ in reader.frames(len(frames))]
        held_count = 0
        for symbols, original, restored in zip(read, frames, decoded, strict=True):
            x = original.vectors_n().astype(float)
            y = restored.forces_at(brick_keys(original.grid, original.bricks)).reshape(-1, 3)
            y = y[original.raster_slots()]
            error, force = np.linalg.norm(x - y, axis=1), np.linalg.norm(x, axis=1)
            is_held = ~symbols.sent
            held_count += is_held.sum()
            assert (error[is_held] <= k * force[is_held] * (1 + 1e-5)).all()
        assert held_count > 1000


def test_trends_of_the_paper_in_one_frame() -> None:
    frames = moving_sheet(1, noise_n=0.02)
    sizes, errors = [], []
    for k in (0.01, 0.4, 0.6):
        body, decoded, _ = encode_and_decode(frames, PaperSpec(k=k, directions="octa3"))
        sizes.append(len(body))
        errors.append(nmse_db(frames, decoded))
    assert sizes[0] > sizes[1] > sizes[2]
    assert errors[0] < errors[1] < errors[2]
    _, coarse, _ = encode_and_decode(frames, PaperSpec(k=0.01, directions="ico3"))
    assert nmse_db(frames, coarse) > errors[0] + 2


def test_static_scene_costs_less_per_frame() -> None:
    frames = moving_sheet(5, noise_n=0.01)
    bits = []
    for m in (1, 2, 5):
        body, _, decoder = encode_and_decode(frames[:m], PaperSpec())
        bits.append(8 * len(body) / m)
        assert [s.kind.name for s in decoder.costs(body, m)] == ["INTRA"] + ["INTER"] * (m - 1)
    assert bits[1] < 0.9 * bits[0]
    assert bits[2] < 0.6 * bits[0]


def test_frame_is_coded_intra_where_that_is_smaller() -> None:
    frames = [moving_sheet(1, noise_n=0.3, seed=s)[0] for s in (1, 2)]
    frames[1] = ForceField.from_dense(frames[1].grid, np.flip(frames[1].to_dense(), 0))
    free, _, _decoder = encode_and_decode(frames, PaperSpec())
    alone, _, _ = encode_and_decode(frames, PaperSpec(interframe="none"))
    forced, _, _ = encode_and_decode(frames, PaperSpec(choose_by_size=False))
    assert len(free) <= min(len(alone), len(forced)) * 1.01


def test_open_loop_drifts_and_closed_loop_does_not() -> None:
    frames = [moving_sheet(1)[0].scaled(1 + 0.1 * t) for t in range(8)]
    coarse = {"choose_by_size": False, "deadband": "none", "nq": 1, "directions": "ico1"}
    _, open_loop, _ = encode_and_decode(frames, PaperSpec(interframe="open", **coarse))
    _, closed, _ = encode_and_decode(frames, PaperSpec(**coarse))
    first, last = (nmse_db(frames[i : i + 1], open_loop[i : i + 1]) for i in (0, 7))
    assert nmse_db(frames[7:], closed[7:]) < min(first, last) - 6


@pytest.mark.parametrize("interframe", ["open", "closed", "none"])
def test_with_fine_quantisation_every_frame_of_a_motion_is_followed(interframe: str) -> None:
    """No frame is coded as a difference from another than the one before it."""
    frames = moving_sheet(5, speed=0.8)
    fine = PaperSpec(
        interframe=interframe,
        amplitude="uniform",
        nq=9,
        deadband="none",
        directions="octa5",
        choose_by_size=False,
    )
    _, decoded, _ = encode_and_decode(frames, fine)
    assert max(nmse_db(frames[i : i + 1], decoded[i : i + 1]) for i in range(5)) < -25


@pytest.mark.parametrize("empty", [(0,), (1,), (0, 1, 2)])
def test_empty_frames(empty: tuple[int, ...]) -> None:
    frames = moving_sheet(3)
    for i in empty:
        frames[i] = ForceField.empty(frames[i].grid)
    _, decoded, _ = encode_and_decode(frames, PaperSpec())
    assert [i for i, f in enumerate(decoded) if not f.support_count] == list(empty)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["default", "literal", "weber", "no-deadband"]))
def test_random_fields_round_trip(seed: int, name: str) -> None:
    rng = np.random.default_rng(seed)
    grid = Grid(tuple(rng.integers(1, 20, 3).tolist()), (1, 1, 1), (0, 0, 0))
    frames = []
    for _ in range(int(rng.integers(1, 4))):
        dense = rng.normal(size=(*grid.shape, 3)) * 10 ** rng.uniform(-3, 1)
        dense[rng.random(grid.shape) > rng.choice([0.01, 0.3, 1.0])] = 0
        frames.append(ForceField.from_dense(grid, dense))
    _, decoded, _ = encode_and_decode(frames, SPECS[name])
    assert len(decoded) == len(frames)


def test_damaged_bodies_raise_only_the_named_errors() -> None:
    frames = moving_sheet(2, noise_n=0.02, speed=0.5)
    body, _, decoder = encode_and_decode(frames, PaperSpec(directions="ico2", nq=3))
    rng = np.random.default_rng(0)
    cuts = [body[:n] for n in sorted({*range(200), *rng.integers(200, len(body), 200).tolist()})]
    for damaged in cuts:
        with pytest.raises(FormatError):
            list(decoder.frames(damaged, 2))
    survived = 0
    for _ in range(400):
        flipped = bytearray(body)
        flipped[rng.integers(len(body))] ^= 1 << rng.integers(8)
        try:
            list(decoder.frames(bytes(flipped), 2))
            survived += 1
        except FormatError:
            pass
    assert survived < 400  # the checksums of the container catch what slips through here
    for _ in range(300):
        with pytest.raises(FormatError):
            list(decoder.frames(rng.bytes(int(rng.integers(0, 400))), 2))


def test_specs_are_checked() -> None:
    for bad in (
        *(
            {"k": 0.0},
            {"k": 1.0},
            {"nq": 0},
            {"nq": 13},
            {"deadband": "x"},
            {"segment_frames": 0},
            {"stage": "x"},
        ),
        *({"step_n": 0.1}, {"stage": "dct", "step_n": 0.0}, {"stage": "dct", "nq": 5}),
    ):
        with pytest.raises(InvalidArgument):
            dataclasses.replace(PaperSpec(), **bad)
    for limit in ({"nq": 1}, {"nq": 12}, {"segment_frames": 1}, {"segment_frames": 4096}, {"k": 0.999}):
        dataclasses.replace(PaperSpec(), **limit)
    for limit in (1e-9, 1e6):
        PaperSpec(stage="dct", step_n=limit)
    with pytest.raises(InvalidArgument):
        PaperEncoder(Grid((8, 8, 8), (1, 1, 1), (0, 0, 0)), PaperSpec(directions="ico99"))


@pytest.mark.parametrize("amplitude", ["uniform", "weber"])
def test_the_largest_force_is_decoded_where_training_takes_every_third_sample(
    amplitude: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("touchfield.codec.paper.encoder._TRAINING_SAMPLES", 200)
    forces_n = np.full((8, 8, 8, 3), (0.0, 0.0, 1.0), np.float32)
    forces_n[3, 2, 4] *= 3.0  # neither the first nor the last, nor at a multiple of three
    grid = Grid((8, 8, 8), (0.001,) * 3, (0.0,) * 3)
    spec = PaperSpec(amplitude=amplitude, deadband="none", interframe="none", directions="octa3")
    encoder = PaperEncoder(grid, spec)
    segment = encoder.encode_segment([ForceField.from_dense(grid, forces_n)])
    (decoded,) = PaperDecoder(grid, encoder.parameters).frames(segment.body, 1)
    assert np.linalg.norm(decoded.to_dense()[3, 2, 4]) == pytest.approx(3.0, rel=0.1)
