"""The quick and the light model keep the rule, give their decoder the same numbers, and name every fault."""

from __future__ import annotations

import contextlib
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from segment_makers import GRID, KINDS, field_of
from touchfield.codec.touch.frame_model import CodedFrame, FrameModel, Known, Rule
from touchfield.codec.touch.light_model import LightModel
from touchfield.codec.touch.light_plan import CLEAN, MOST, Plan, law_of, plan_of
from touchfield.codec.touch.light_scan import scan_of
from touchfield.codec.touch.quick_model import QuickModel

from touchfield.codec.touch.fixed_field import FixedField
from touchfield.codec.touch.lattice import Lattice
from touchfield.codec.varint import read_varint
from touchfield.errors import CorruptFile, FormatError, TruncatedFile
from touchfield.medium import ForceField, Grid
from touchfield.medium.field import brick_keys

MODELS: tuple[FrameModel, ...] = (QuickModel(), LightModel())
RULES = (
    Rule(0.1, 0.05),
    Rule(0.1, 0.05, movable=False),
    Rule(0.25, 0.0),
    Rule(0.01, 0.2),
    Rule(0.1, 0.05, sine=0.3),
    Rule(0.0, 0.0, free=True),
    Rule(0.0, 0.0, free=True, movable=False),
)


def lattice_of(frame: ForceField, rule: Rule) -> Lattice:
    most = max(float(np.sqrt((frame.forces_n.astype(np.float64) ** 2).sum(-1)).max(initial=0.0)), 1e-40)
    unit = float(np.maximum(np.float32(most / 65536), np.float32(1e-45)))
    if rule.free:
        return Lattice(unit, 1200, 0, 1200, 0)
    floor = int(np.clip(round(1.13 * rule.f0_n / unit), 1, 65535))
    rate = round(1.13 * rule.k * 65536)
    return Lattice(unit, floor, rate, floor, rate)


def beyond(frame: ForceField, coded: CodedFrame, unit_n: float, rule: Rule) -> np.ndarray:
    """Slots of `coded` that break the mask or the support, in newtons of float64 as a reader would find them."""
    made = coded.decoded.vectors.astype(np.float32) * np.float32(unit_n)
    force = frame.forces_at(brick_keys(frame.grid, coded.decoded.bricks)).astype(np.float64)
    error = np.sqrt(((made - force) ** 2).sum(-1))
    wrong = error > np.maximum(rule.f0_n, rule.k * np.sqrt((force**2).sum(-1))) * (1 + 1e-9)
    if rule.free:
        wrong[:] = False
    if not rule.movable:
        wrong |= made.any(-1) != force.any(-1)
    return np.flatnonzero(wrong.reshape(-1))


def checked(model: FrameModel, frame: ForceField, known: Known, rule: Rule) -> CodedFrame:
    """Code and decode: equal numbers, the rule kept but for the misses, bricks of the frame only."""
    coded = model.encode(frame, known, rule)
    decoded = model.decode(coded.payload, known)
    assert np.array_equal(decoded.bricks, coded.decoded.bricks)
    assert np.array_equal(decoded.vectors, coded.decoded.vectors)
    if rule.sine == 0:
        assert set(beyond(frame, coded, known.lattice.unit_n, rule)) <= set(coded.misses.tolist())
    assert np.isin(brick_keys(frame.grid, decoded.bricks), brick_keys(frame.grid, frame.bricks)).all()
    left = ForceField.from_bricks(frame.grid, frame.bricks, frame.forces_n)
    lost = ~np.isin(brick_keys(left.grid, left.bricks), brick_keys(frame.grid, decoded.bricks))
    if not rule.free:
        assert (np.sqrt((left.forces_n[lost].astype(np.float64) ** 2).sum(-1)) <= rule.f0_n).all()
    decoded.field(frame.grid, known.lattice.unit_n)  # nothing beyond the grid, nothing out of order
    assert sum(coded.bits) == pytest.approx(8 * len(coded.payload), rel=0.01, abs=64)
    assert min(coded.bits) >= 0
    return coded


@settings(max_examples=60)
@given(st.sampled_from(KINDS), st.integers(0, 999), st.sampled_from(MODELS), st.sampled_from(RULES), st.booleans())
@example("huge", 0, MODELS[0], RULES[1], False)
@example("denormal", 0, MODELS[1], RULES[1], True)
def test_any_field_comes_back(kind: str, seed: int, model: FrameModel, rule: Rule, inter: bool) -> None:
    frame = field_of(kind, seed)
    known = Known(frame.grid, lattice_of(frame, rule))
    first = checked(model, frame, known, rule)
    if inter:
        other = field_of("dense" if seed % 2 else kind, seed + 1)
        lattice = lattice_of(other if seed % 2 else frame, rule)
        known = Known(frame.grid, lattice, first.decoded, first.decoded if seed % 3 else None)
        checked(model, other, known, rule)


def smooth(count: int = 24, shift: float = 0.0) -> ForceField:
    """A ball under a penalty law, saturated inside."""
    grid = Grid((count, count, count), (1e-3, 1e-3, 1e-3), (0, 0, 0))
    x = np.stack(np.meshgrid(*(np.arange(count),) * 3, indexing="ij"), -1) - count / 2 - shift
    r = np.linalg.norm(x, axis=-1, keepdims=True) + 1e-9
    depth = np.clip(count * 0.4 - r, 0, 5)
    return ForceField.from_dense(grid, (0.6 * depth * x / r).astype(np.float32))


@pytest.mark.parametrize(("model", "bits"), [(MODELS[0], 4.5), (MODELS[1], 3.5)], ids=["fast", "default"])
def test_a_smooth_field_misses_nothing_and_costs_little(model: FrameModel, bits: float) -> None:
    frame, rule = smooth(), RULES[0]
    coded = checked(model, frame, Known(frame.grid, lattice_of(frame, rule)), rule)
    assert len(coded.misses) == 0
    assert 8 * len(coded.payload) < bits * frame.support_count


@pytest.mark.parametrize("model", MODELS, ids=["fast", "default"])
def test_a_standing_frame_is_nearly_free(model: FrameModel) -> None:
    frame, rule = smooth(), RULES[0]
    known = Known(frame.grid, lattice_of(frame, rule))
    first = checked(model, frame, known, rule)
    again = checked(model, frame, replace(known, previous=first.decoded), rule)
    assert len(again.payload) < 0.1 * len(first.payload)
    assert np.array_equal(again.decoded.vectors, first.decoded.vectors)
    guessed = checked(model, frame, replace(known, guess=first.decoded), rule)
    assert len(guessed.payload) < 0.2 * len(first.payload)


def test_mixing_pays() -> None:
    frame, rule = smooth(40), RULES[0]
    known = Known(frame.grid, lattice_of(frame, rule))
    fast, default = (len(model.encode(frame, known, rule).payload) for model in MODELS)
    assert default < fast


def test_saturated_solids_are_nearly_free() -> None:
    grid = Grid((32, 32, 64), (1e-3, 1e-3, 1e-3), (0, 0, 0))
    dense = np.zeros((32, 32, 64, 3), np.float32)
    dense[4:28, 5:29, :60] = (0.1, 0.2, 3.0)
    frame = ForceField.from_dense(grid, dense)
    for model in MODELS:
        coded = checked(model, frame, Known(grid, lattice_of(frame, RULES[1])), RULES[1])
        assert len(coded.payload) < 250
        assert len(coded.misses) == 0


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_the_scan_follows_the_force_on_grids_that_no_brick_divides(axis: int, sign: int) -> None:
    dense = np.zeros((*GRID.shape, 3), np.float32)
    level = np.indices(GRID.shape)[axis]
    dense[..., axis] = sign * np.maximum(0.0, (GRID.shape[axis] - 3 - level if sign > 0 else level - 3)) * 0.2
    dense[..., (axis + 1) % 3] = 0.1 * (dense[..., axis] != 0)
    frame = ForceField.from_dense(GRID, dense)
    for model in MODELS:
        coded = checked(model, frame, Known(GRID, lattice_of(frame, RULES[0])), RULES[0])
        assert coded.payload[1 + coded.payload[0]] & 3 == axis
        assert coded.payload[1 + coded.payload[0]] >> 2 & 1 == (sign < 0)
        assert len(coded.misses) == 0


def test_bricks_far_apart_take_no_more_memory_than_their_number_says() -> None:
    grid = Grid((1 << 13, 1 << 13, 1 << 13), (1e-3, 1e-3, 1e-3), (0, 0, 0))
    positions = np.array([(1000 * i, 8191 - 900 * i, (777 * i) % 8192) for i in range(8)])
    frame = ForceField.from_support(grid, positions, np.full((8, 3), 0.7, np.float32))
    known = Known(grid, lattice_of(frame, RULES[1]))
    tracemalloc.start()
    coded = checked(MODELS[1], frame, known, RULES[1])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 << 20
    assert len(coded.payload) < 300


def whole() -> tuple[FrameModel, Known, bytes]:
    frame = smooth(20, 0.3)
    known = Known(frame.grid, lattice_of(frame, RULES[0]))
    return MODELS[1], known, MODELS[1].encode(frame, known, RULES[0]).payload


def test_truncated_frames_are_named() -> None:
    model, known, payload = whole()
    for size in (*range(60), *range(60, len(payload) - 8, 37)):
        with pytest.raises(FormatError):
            model.decode(payload[:size], known)
    with pytest.raises(TruncatedFile):
        model.decode(payload[: len(payload) // 2], known)
    with pytest.raises(CorruptFile, match="behind the end"):
        model.decode(payload + bytes(9), known)


@settings(max_examples=150)
@given(st.data())
def test_changed_frames_give_a_frame_or_a_named_error(data: st.DataObject) -> None:
    _, known, payload = whole()
    model = data.draw(st.sampled_from(MODELS))
    changed = bytearray(payload)
    for _ in range(data.draw(st.integers(1, 4))):
        head = data.draw(st.booleans())
        changed[data.draw(st.integers(0, 90 if head else len(changed) - 1))] = data.draw(st.integers(0, 255))
    with contextlib.suppress(FormatError):
        decoded = model.decode(bytes(changed), known)
        assert isinstance(decoded, FixedField)
        assert np.abs(decoded.vectors).max(initial=0) < 1 << 17
        decoded.field(known.grid, known.lattice.unit_n)


@settings(max_examples=100)
@given(st.binary(max_size=200), st.sampled_from(MODELS), st.sampled_from((1, 65535)), st.sampled_from((0, 131071)))
def test_any_bytes_give_a_frame_or_a_named_error(data: bytes, model: FrameModel, floor: int, rate: int) -> None:
    before = FixedField(np.zeros((1, 3), np.int32), np.full((1, 8, 8, 8, 3), (1 << 17) - 1, np.int32))
    known = Known(GRID, Lattice(1e-5, floor, rate, floor, rate), before)
    with contextlib.suppress(FormatError):
        decoded = model.decode(data, known)
        assert np.abs(decoded.vectors).max(initial=0) < 1 << 17


def test_a_closed_direction_rule_is_kept() -> None:
    frame, rule = smooth(), Rule(0.1, 0.05, sine=0.3)
    lattice = replace(lattice_of(frame, rule), cross_rate=round(1.2 * 0.3 * 65536))
    coded = checked(MODELS[1], frame, Known(frame.grid, lattice), rule)
    made = coded.decoded.vectors.reshape(-1, 3).astype(np.float32) * np.float32(lattice.unit_n)
    force = frame.forces_at(brick_keys(frame.grid, coded.decoded.bricks)).reshape(-1, 3).astype(np.float64)
    keep = np.setdiff1d(np.arange(len(made)), coded.misses)
    made, force = made[keep].astype(np.float64), force[keep]
    a, b = np.linalg.norm(force, axis=1), np.linalg.norm(made, axis=1)
    assert (np.abs(a - b) <= np.maximum(0.05, 0.1 * a)).all()
    large = a > 0.05 / 0.3
    cross = np.linalg.norm(np.cross(force, made), axis=1)
    assert (cross[large] <= 0.3 * a[large] * b[large]).all()
    assert len(coded.misses) < 0.01 * frame.support_count


def test_the_law_of_a_penalty_field_is_found() -> None:
    from touchfield.codec.kernels.touch_light_chain import falls

    frame = smooth(40)
    counts, _ = falls(frame.forces_n, 65536 / 3)
    assert law_of(counts, frame.grid, 1) == pytest.approx([0.6 * 65536 / 3] * 3, rel=0.05)
    assert law_of(np.zeros_like(counts), frame.grid, 1)[0] > 0


def plan_for(frame: ForceField, known: Known, rule: Rule, guessed: bool = False) -> Plan:
    """What `LightModel.encode` plans, along x, y and z as they are."""
    from touchfield.codec.kernels.touch_light_chain import chain_breaks, falls

    scale = 1 / known.lattice.unit_n
    scan, reference = scan_of(known, np.array(frame.bricks), 0)
    slope = np.rint(law_of(falls(frame.forces_n, scale)[0], frame.grid, 0)).astype(np.int64)
    numbers = np.array([rule.k, rule.f0_n * scale, rule.sine, rule.thrift, rule.free, rule.movable], np.float64)
    steps = [known.lattice.floor, known.lattice.rate]
    law = np.array([*slope, 0, 1, 2, 1, 0, 0, 0, *steps], np.int64)
    breaks = chain_breaks(
        frame.forces_n.reshape(-1, 3), scale, numbers, scan.where, scan.stride, law, *steps, reference,
        scan.reference_slot,
    )  # fmt: skip
    return plan_of(breaks, scan.reference_slot, frame.support_count, chains=not rule.free, most=MOST, guessed=guessed)


def test_a_clean_field_is_followed_along_its_force_and_a_noisy_one_blended() -> None:
    grid = Grid((32, 32, 32), (1e-3, 1e-3, 1e-3), (0, 0, 0))
    dense = np.zeros((32, 32, 32, 3), np.float32)
    height = 20 + np.rint(3 * np.sin(np.arange(32) / 3))[:, None] * np.ones(32)
    dense[..., 0] = 0.15 * np.maximum(0, height.T[None] - np.arange(32)[:, None, None])
    frame = ForceField.from_dense(grid, dense)
    plan = plan_for(frame, Known(grid, lattice_of(frame, RULES[0])), RULES[0])
    assert (plan.usual, plan.mix) == (1, 0)
    assert plan.share < CLEAN / 2
    noise = np.random.default_rng(0).normal(0, 0.2, dense.shape).astype(np.float32)
    frame = ForceField.from_dense(grid, np.where(dense[..., :1] > 0, dense + noise, 0))
    plan = plan_for(frame, Known(grid, lattice_of(frame, RULES[0])), RULES[0])
    assert plan.mix > 0
    assert plan_for(frame, Known(grid, lattice_of(frame, RULES[5])), RULES[5]).usual == 0


def test_bricks_that_stand_still_follow_the_reference() -> None:
    frame, rule = smooth(), RULES[0]
    known = Known(frame.grid, lattice_of(frame, rule))
    before = checked(MODELS[0], frame, known, rule).decoded
    plan = plan_for(frame, replace(known, previous=before), rule)
    assert (plan.ways == 0).mean() > 0.9
    assert plan.share == 0


def test_a_mix_with_nothing_to_follow_is_named() -> None:
    model, known, payload = whole()
    at = 2 + payload[0]
    for _ in range(3):
        _, at = read_varint(payload, at, "slope", 1 << 18)
    assert payload[at] >> 6
    with pytest.raises(CorruptFile, match="nothing to follow"):
        model.decode(payload[:at] + b"\x05" + payload[at + 1 :], known)


@pytest.mark.parametrize("model", MODELS, ids=["fast", "default"])
def test_a_guess_that_is_off_is_left_for_the_chain(model: LightModel) -> None:
    """Where the guess is off by the same everywhere, it is corrected once, not at each sample."""
    frame, rule = smooth(), RULES[0]
    known = Known(frame.grid, lattice_of(frame, rule))
    decoded = checked(model, frame, known, rule).decoded
    off = FixedField(decoded.bricks, np.where(decoded.vectors != 0, decoded.vectors * 5 // 4, 0))
    alone = len(checked(model, frame, known, rule).payload)
    guided = checked(model, frame, replace(known, guess=off), rule)
    assert plan_for(frame, replace(known, guess=off), rule, guessed=True).ways.max() == 0
    assert len(guided.payload) < alone


def test_chains_are_followed_in_mode_nmse_where_they_pay() -> None:
    frame, rule = smooth(40), RULES[5]
    known = Known(frame.grid, lattice_of(frame, rule))
    coded = checked(MODELS[1], frame, known, rule)
    at = 2 + coded.payload[0]
    for _ in range(3):
        _, at = read_varint(coded.payload, at, "slope", 1 << 18)
    assert coded.payload[at] >> 6 > 0
