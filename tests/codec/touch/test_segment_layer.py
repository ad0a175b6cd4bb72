"""The segment layer keeps the promise whatever a frame model does, and reads back only what it wrote."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from segment_makers import GRID, KINDS, PlainModel, Shifted, field_of
from touchfield.codec.touch.frame_model import CodedFrame, DecodedFrame, Known, Rule
from touchfield.codec.touch.scale import LEAST_RATE, LEAST_UNIFORM, lattice_for
from touchfield.codec.touch.warp import warp_of

from touchfield.codec.registry import decoder_class, field_decoder
from touchfield.codec.segment import CodedSegment, FrameKind
from touchfield.codec.touch import models
from touchfield.codec.touch.body import BodyReader, GuessKind, shares_of, write_body
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.fixed_field import FixedField
from touchfield.codec.touch.lattice import Lattice
from touchfield.codec.touch.promise import compared
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import CorruptFile, FormatError, InvalidArgument, UnsupportedVersion
from touchfield.medium import ForceField, Grid
from touchfield.perception.mask import violations

SPEC = TouchSpec(k=0.1, f0_n=0.05)
SPECS = (
    SPEC,
    replace(SPEC, f0_n=0.0, effort="fast"),
    replace(SPEC, support="exact", effort="max"),
    replace(SPEC, mode="mask-direction"),
    replace(SPEC, mode="mask-direction", f0_n=0.0, support="exact"),
    replace(SPEC, k=0.001, f0_n=1e-6),
    replace(SPEC, mode="nmse", step_n=0.02, support="exact"),
    replace(SPEC, f0_n=100.0),
)


@pytest.fixture(autouse=True, params=[True, False], ids=["honest", "silent"])
def plain_models(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Plain models in place of all; silent ones leave it to the encoder to find their misses."""
    monkeypatch.setattr(models, "_made", lambda number: PlainModel(number, request.param))
    for name in ("motion", "surface"):
        monkeypatch.setitem(sys.modules, f"touchfield.codec.touch.{name}", None)  # type: ignore[arg-type]
    return


def coded(frames: list[ForceField], spec: TouchSpec = SPEC) -> tuple[CodedSegment, TouchDecoder, list[ForceField]]:
    encoder = TouchEncoder(frames[0].grid, spec)
    segment = encoder.encode_segment(frames)
    decoder = TouchDecoder(frames[0].grid, encoder.parameters)
    return segment, decoder, list(decoder.frames(segment.body, len(frames)))


def wobbling(seed: int = 0, count: int = 4) -> list[ForceField]:
    """A dense field that changes a little, with a frame of another kind among them."""
    first = field_of("dense", seed)
    frames = [first.scaled(1 + 0.03 * i) for i in range(count)]
    frames[2 % count] = field_of("sparse", seed)
    return frames


@given(st.lists(st.sampled_from(KINDS), min_size=1, max_size=3), st.integers(0, 999), st.sampled_from(SPECS))
def test_the_promise_is_kept(kinds: list[str], seed: int, spec: TouchSpec) -> None:
    frames = [field_of(kind, seed + i) for i, kind in enumerate(kinds)]
    segment, decoder, decoded = coded(frames, spec)
    ratios = []
    for original, made in zip(frames, decoded, strict=True):
        found = compared(original, made, spec)
        assert not len(found.keys)
        ratios.append(found.worst)
        if spec.mode == "mask":
            a, b = (f.to_dense().reshape(-1, 3) for f in (original, made))
            assert violations(a, b, spec.k, spec.f0_n).count == 0
        if spec.support == "exact":
            assert np.array_equal((original.to_dense() != 0).any(-1), (made.to_dense() != 0).any(-1))
    told = decoder.promise(segment.body)
    if spec.mode == "nmse":
        assert told.worst is None
        return
    assert told.worst is not None
    assert max(ratios) <= told.worst.ratio <= min(1.0, max(ratios) + 1 / 65535 + 1e-12)
    assert ratios[told.worst.frame] == max(ratios)
    if max(ratios) > 0:
        x, y, z = told.worst.voxel
        differs = frames[told.worst.frame].to_dense() != decoded[told.worst.frame].to_dense()
        assert differs[x, y, z].any()


@given(st.sampled_from(KINDS), st.integers(0, 999), st.sampled_from(SPECS))
def test_what_was_decoded_can_be_coded_again(kind: str, seed: int, spec: TouchSpec) -> None:
    segment, _, (once,) = coded([field_of(kind, seed)], spec)
    again, _, (twice,) = coded([once], spec)
    assert not len(compared(once, twice, spec).keys)
    assert coded([once], spec)[0].body == again.body  # equal fields, equal bytes
    assert segment.frames[0].supported == once.support_count


def test_segments_do_not_know_each_other() -> None:
    encoder = TouchEncoder(GRID, SPEC)
    segments = [wobbling(seed, 2) for seed in range(4)]
    forth = [encoder.encode_segment(frames).body for frames in segments]
    back = [encoder.encode_segment(frames).body for frames in reversed(segments)]
    assert forth == back[::-1]
    decoder = TouchDecoder(GRID, encoder.parameters)
    alone = {i: list(decoder.frames(forth[i], 2)) for i in (2, 0, 3, 1)}
    assert all(alone[i] == list(TouchDecoder(GRID, encoder.parameters).frames(forth[i], 2)) for i in range(4))


@pytest.mark.parametrize("effort", ["fast", "default", "max"])
def test_a_frame_is_coded_after_the_one_before_where_that_is_smaller(effort: str) -> None:
    frames = wobbling()
    spec = replace(SPEC, effort=effort)
    segment, decoder, decoded = coded(frames, spec)
    costs = decoder.costs(segment.body, 4)
    assert [c.kind for c in costs][:2] == [FrameKind.INTRA, FrameKind.INTER]
    alone, _, _ = coded(frames, replace(spec, interframe="off"))
    assert len(segment.body) < len(alone.body)
    assert all(f.kind == FrameKind.INTRA for f in alone.frames)
    forced, _, _ = coded(frames, replace(spec, interframe="on"))
    assert [f.kind for f in forced.frames] == [FrameKind.INTRA] + 3 * [FrameKind.INTER]
    assert decoded[3].support_count == segment.frames[3].supported
    # bits by kind, with and without decoding
    assert [c.bits for c in costs] == [s.bits for s in segment.frames]
    assert decoder.stats(segment.body, 4) == list(segment.frames)
    header = 8 * len(segment.body) - sum(c.bits.total for c in costs)
    assert 0 < header < 8 * 40
    for c in costs:
        assert c.bits.amplitude == pytest.approx(2 * c.bits.support, rel=0.05)


def test_guesses_are_tried_and_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "touchfield.codec.touch.motion", Shifted)  # type: ignore[arg-type]
    frames = [field_of("dense", 1)] * 3
    spec = replace(SPEC, motion="on", interframe="auto", effort="max")
    segment, decoder, decoded = coded(frames, spec)
    costs = decoder.costs(segment.body, 3)
    assert [c.guess for c in costs] == [GuessKind.NONE, GuessKind.MOTION, GuessKind.MOTION]
    assert [c.kind for c in costs] == [FrameKind.INTRA, FrameKind.INTER, FrameKind.INTER]
    assert costs[1].guess_bits == costs[1].bits.models == 24 and costs[0].guess_bits == 0
    assert decoded[0] == decoded[1] == decoded[2]
    for off in (replace(spec, motion="off"), replace(spec, motion="auto"), replace(spec, interframe="off")):
        body = coded(frames, off)[0].body
        assert all(c.guess == GuessKind.NONE for c in decoder.costs(body, 3))  # auto: no gain over the previous frame
    # what needs a guess that this program cannot make says so
    monkeypatch.setitem(sys.modules, "touchfield.codec.touch.motion", None)  # type: ignore[arg-type]
    with pytest.raises(UnsupportedVersion):
        list(decoder.frames(segment.body, 3))


def test_damaged_bodies_raise_only_the_named_errors() -> None:
    grid = Grid((9, 5, 7), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    frames = [field_of(kind, 1, grid) for kind in ("huge", "sparse", "dense", "constant")]
    segment, decoder, _ = coded(frames)
    body = segment.body
    rng = np.random.default_rng(0)
    for n in sorted({*range(60), *rng.integers(60, len(body), 60).tolist()}):
        with pytest.raises(FormatError):
            list(decoder.frames(body[:n], 4))
    survived = 0
    heads = [c.bits.total // 8 for c in decoder.costs(body, 4)]
    spots = [*range(60), *np.cumsum([20, *heads[:-1]]).tolist(), *rng.integers(0, len(body), 100).tolist()]
    for place in spots:
        flipped = bytearray(body)
        flipped[place] ^= 1 << rng.integers(8)
        try:
            list(decoder.frames(bytes(flipped), 4))
            decoder.costs(bytes(flipped), 4)
            decoder.promise(bytes(flipped))
            survived += 1
        except FormatError:
            pass
    assert survived < len(spots)
    for _ in range(100):
        with pytest.raises(FormatError):
            list(decoder.frames(rng.bytes(int(rng.integers(0, 300))), 2))
    with pytest.raises(FormatError):
        list(decoder.frames(body, 3))
    with pytest.raises(FormatError):
        list(decoder.frames(body, 5))


def test_fields_that_cannot_be_coded_are_refused_by_name() -> None:
    good = field_of("sparse", 1)
    for bad, told in ((np.nan, "NaN"), (np.inf, "infinite"), (-np.inf, "infinite"), (3e38, "2\\^120")):
        forces = np.array(good.forces_n)
        forces[0, 1, 2, 3, 1] = bad
        with pytest.raises(InvalidArgument, match=f"frame 1.*{told}"):
            TouchEncoder(GRID, SPEC).encode_segment([good, ForceField(GRID, good.bricks, forces)])
    other = Grid((8, 8, 8), (1, 1, 1), (0, 0, 0))
    with pytest.raises(InvalidArgument, match="grid"):
        TouchEncoder(GRID, SPEC).encode_segment([ForceField.empty(other)])


@pytest.mark.parametrize("spec", [*SPECS, replace(SPEC, mode="nmse", step_n=0.3), replace(SPEC, mode="lossless")])
def test_parameters_tell_what_was_asked_for(spec: TouchSpec) -> None:
    parameters = TouchEncoder(GRID, spec).parameters
    read = TouchDecoder(GRID, parameters).spec
    used = {"mask": ("k", "f0_n"), "mask-direction": ("k", "f0_n", "direction_jnd_deg"), "nmse": ("step_n",)}
    for name in ("mode", "support", "effort", *used.get(spec.mode, ())):
        assert getattr(read, name) == getattr(spec, name)
    assert TouchDecoder(GRID, parameters).describe()["mode"] == spec.mode
    for n in range(len(parameters)):
        with pytest.raises(CorruptFile, match="HEAD"):
            TouchDecoder(GRID, parameters[:n])
    with pytest.raises(UnsupportedVersion):
        TouchDecoder(GRID, b"\2" + parameters[1:])
    with pytest.raises(CorruptFile):
        TouchDecoder(GRID, parameters + b"\0")
    with pytest.raises(CorruptFile):
        TouchDecoder(GRID, bytes([1, 24, *parameters[2:]]))
    if len(parameters) > 2:
        with pytest.raises(CorruptFile):
            TouchDecoder(GRID, parameters[:-8] + np.float64(-np.inf).tobytes())


def test_the_registry_knows_the_coder() -> None:
    assert decoder_class("touch") is TouchDecoder
    assert isinstance(field_decoder("touch", GRID, TouchEncoder(GRID, SPEC).parameters, "OBJT 0"), TouchDecoder)
    with pytest.raises(CorruptFile, match="OBJT 7 field_parameters"):
        field_decoder("touch", GRID, b"", "OBJT 7")


def test_symbols_of_the_measures() -> None:
    segment, decoder, (field, *_) = coded([field_of("dense", 3), field_of("sparse", 1)])
    quantise = decoder.quantiser(segment.body)
    symbols = quantise(field)
    assert symbols.shape == (field.support_count,) and len(np.unique(symbols)) > 20
    assert quantise(field.scaled(100)).max() < 1 << 31  # forces that no frame of the segment had
    assert (quantise(field) == symbols).all()


def test_lattices_fit_the_mask() -> None:
    for longest in (0.0, 1e-42, 1e-3, 3.3, 1e30):
        for spec in SPECS:
            lattice = lattice_for(spec, longest)
            assert lattice.unit_n == np.float32(lattice.unit_n) > 0
            assert longest <= lattice.unit_n * 65536 * (1 + 1e-6)
            assert 1 <= lattice.floor < 65536 and 1 <= lattice.cross_floor < 65536
            assert 0 <= lattice.rate < 1 << 17 and 0 <= lattice.cross_rate < 1 << 17
    lattice = lattice_for(SPEC, 3.3)
    # a cell's corners alone may be beyond the ball
    assert 0.95 < lattice.floor * lattice.unit_n * np.sqrt(3) / 2 / 0.05 < 1.05
    assert 0.95 < lattice.rate / 65536 * np.sqrt(3) / 2 / 0.1 < 1.05
    wide = lattice_for(replace(SPEC, mode="mask-direction", direction_jnd_deg=18.4), 3.3)
    assert (
        1.5 * lattice.rate < wide.rate < 65536 * 2 * 0.1
        and 0.9 < wide.cross_rate / 65536 / np.sqrt(2) / np.sin(np.radians(18.4)) < 1
    )
    assert lattice_for(replace(SPEC, mode="nmse", step_n=0.02), 3.3).floor == int(0.02 / np.float32(3.3 / 65536))


@pytest.mark.parametrize("longest", [1e-3, 3.3, 1e30])
@pytest.mark.parametrize(
    "more", [{"k": 0.001, "f0_n": 0.0}, {"k": 0.001, "f0_n": 0.0, "mode": "mask-direction"}, {"step_n": 1e-9}]
)
def test_the_table_of_a_lattice_is_short(more: dict[str, Any], longest: float) -> None:
    for effort in ("fast", "default", "max"):
        lattice = lattice_for(
            TouchSpec(**{"mode": "nmse" if "step_n" in more else "mask", **more}, effort=effort), longest
        )
        assert 1000 < len(warp_of(lattice.floor, lattice.rate)[0]) <= 200_000
    for floor, rate in ((LEAST_UNIFORM, 0), (LEAST_UNIFORM, 3), (1, LEAST_RATE)):
        assert len(warp_of(floor, rate)[0]) <= 200_000


def test_a_lattice_of_a_long_table_is_refused() -> None:
    _, decoder, _ = coded([field_of("dense", 3)])
    for floor, rate in ((LEAST_UNIFORM - 1, LEAST_RATE - 1), (1, 0)):
        body = write_body(Lattice(1e-4, floor, rate, 1, 0), [], None)
        with pytest.raises(CorruptFile, match="lattice"):
            list(decoder.frames(body, 0))
    assert list(decoder.frames(write_body(Lattice(1e-4, 1, LEAST_RATE, 1, 0), [], None), 0)) == []


class Drifting(PlainModel):
    """Decodes another field than its encoder predicts from."""

    def decode(self, payload: bytes, known: Known) -> FixedField:
        made = super().decode(payload, known)
        return FixedField(made.bricks, made.vectors + (made.vectors != 0))


@pytest.mark.parametrize("spec", [SPEC, TouchSpec(mode="nmse"), TouchSpec(mode="nmse", support="exact")])
def test_an_encoder_that_drifts_from_its_decoder_writes_nothing(
    spec: TouchSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(models, "_made", Drifting)
    with pytest.raises(AssertionError, match="frame model 1 does not decode"):
        coded([field_of("dense", 3)], spec)


@dataclass(frozen=True)
class Counting(PlainModel):
    """Learns how many frames it has coded, and sends it."""

    def encode(self, frame: ForceField, known: Known, rule: Rule) -> CodedFrame:
        made, count = super().encode(frame, known, rule), known.memory or 0
        return replace(made, payload=bytes([count]) + made.payload, memory=count + 1)

    def decode(self, payload: bytes, known: Known) -> FixedField:
        return self.decode_with_memory(payload, known).field

    def decode_with_memory(self, payload: bytes, known: Known) -> DecodedFrame:
        count = known.memory or 0
        if payload[0] != count:
            raise CorruptFile("count", str(payload[0]), str(count))
        return DecodedFrame(super().decode(payload[1:], known), count + 1)


def test_what_a_model_has_learnt_is_known_to_frames_that_are_not_coded_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(models, "_made", Counting)
    for asked, counts in (("on", [0, 1, 2, 3]), ("off", [0, 0, 0, 0])):
        segment, _, _ = coded(wobbling(), replace(SPEC, interframe=asked))
        records = BodyReader(segment.body, GRID, lossless=False).records(4)
        assert [record.payload[0] for record in records] == counts


def test_shares_are_of_255() -> None:
    assert shares_of((0.0, 0.0, 0.0)) == (255, 0)
    assert shares_of((1.0, 1.0, 0.0)) == (128, 127)
    assert shares_of((0.0, 0.0, 5.0)) == (0, 0)
    rng = np.random.default_rng(1)
    for bits in rng.random((100, 3)):
        support, amplitude = shares_of(tuple(bits))
        assert support >= 0 and amplitude >= 0 and support + amplitude <= 255


def test_a_body_says_what_it_is_made_of() -> None:
    segment, _, _ = coded([field_of("dense", 3)])
    reader = BodyReader(segment.body, GRID, lossless=False)
    assert reader.lattice == lattice_for(SPEC, float(np.sqrt((field_of("dense", 3).to_dense() ** 2).sum(-1).max())))
    (record,) = reader.records(1)
    assert (record.model, record.inter, record.guess_kind, record.exceptions) == (1, False, GuessKind.NONE, b"")
    with pytest.raises(CorruptFile):
        list(BodyReader(segment.body, GRID, lossless=True).records(1))
