"""The filter after a frame: it keeps the support, reads back what was written, and is only there where it pays."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from touchfield.codec.touch.post_filter import (
    GROUPS,
    TERMS,
    Terms,
    clip_of,
    filtered,
    members,
    read_terms,
    size_of,
    write_terms,
)
from touchfield.codec.touch.post_filter_fit import error_of, fitted, worth

from touchfield.codec.touch.body import BodyReader
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.fixed_field import FixedField
from touchfield.codec.touch.lattice import Lattice
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import CorruptFile, FormatError, TruncatedFile
from touchfield.medium import ForceField, Grid

CONFORMANCE = Path(__file__).resolve().parents[3] / "conformance"
GRID = Grid((20, 17, 19), (0.001, 0.002, 0.0015), (0.0, 0.01, -0.02))
LATTICE = Lattice(1e-4, 800, 0, 800, 0)
LIMIT = (1 << 17) - 1

terms = st.dictionaries(st.integers(0, TERMS - 1), st.integers(0, 255), max_size=12).map(
    lambda found: Terms(tuple(sorted(found)), tuple(found[n] for n in sorted(found)))
)


def reference() -> Any:
    if str(CONFORMANCE) not in sys.path:
        sys.path.append(str(CONFORMANCE))
    import reference_touch
    import reference_touch_post

    return reference_touch, reference_touch_post


def some_field(seed: int, size: int = 3000) -> FixedField:
    """Some bricks, not all of them, with forces in about half of their samples."""
    rng = np.random.default_rng(seed)
    chosen = np.sort(rng.choice(27, 9, replace=False))
    bricks = np.stack(np.unravel_index(chosen, (3, 3, 3)), axis=-1).astype(np.int32)
    vectors = rng.integers(-size, size + 1, (9, 8, 8, 8, 3)) * (rng.random((9, 8, 8, 8, 1)) < 0.5)
    return FixedField(bricks, vectors.astype(np.int32))


def smooth(noise: float = 0.0) -> ForceField:
    """A bent slab whose force grows with depth."""
    i = np.moveaxis(np.indices(GRID.shape), 0, -1).astype(np.float64)
    depth = i[..., 2] - 5 - 1.5 * np.sin(i[..., 0] / 4)
    f = np.stack([0.3 * np.cos(i[..., 0] / 4), 0.2 * np.sin(i[..., 1] / 5), np.full(GRID.shape, -1.0)], axis=-1)
    f *= (np.clip(depth, 0, 6) * ((depth > 0) & (depth < 7)))[..., None] * 0.3
    f += (f != 0) * noise * np.random.default_rng(0).normal(size=f.shape)
    return ForceField.from_dense(GRID, f.astype(np.float32))


@given(terms)
def test_terms_read_back(one: Terms) -> None:
    assert read_terms(write_terms(one)) == one


def test_groups_hold_what_the_chapter_says() -> None:
    _, post = reference()
    assert members().shape == (GROUPS, 26)
    for g in range(GROUPS):
        assert np.flatnonzero(members()[g]).tolist() == sorted(post.group(g))
    assert size_of(0) == 8 and size_of(128) == -8 and size_of(127) == 15 << 15


@pytest.mark.parametrize(
    ("data", "error"),
    [
        (b"\x01", TruncatedFile),
        (b"\x02\x00\x01\x00", CorruptFile),
        (b"\x02\x00\x02\x00", CorruptFile),
        (bytes([TERMS, 0]), CorruptFile),
    ],
)
def test_other_bytes_are_refused(data: bytes, error: type[FormatError]) -> None:
    with pytest.raises(error):
        read_terms(data)


@given(terms, st.integers(0, 99), st.sampled_from([3, 3000, LIMIT]))
def test_both_decoders_agree_and_the_support_stays(one: Terms, seed: int, size: int) -> None:
    touch, post = reference()
    field = some_field(seed, size)
    made = filtered(field, one, GRID, LATTICE)
    assert np.array_equal(made.vectors.any(-1), field.vectors.any(-1))
    assert np.abs(made.vectors.astype(np.int64)).max() <= LIMIT
    plain = touch.Field()
    for brick, vectors in zip(field.bricks.tolist(), field.vectors, strict=True):
        for place in np.argwhere(vectors.any(-1)).tolist():
            at = tuple(8 * b + p for b, p in zip(brick, place, strict=True))
            plain.vectors[at] = tuple(int(v) for v in vectors[tuple(place)])
    theirs = post.filtered(plain, write_terms(one), LATTICE.floor).vectors
    assert len(theirs) == np.count_nonzero(field.vectors.any(-1))
    where = {tuple(b): i for i, b in enumerate(field.bricks.tolist())}
    for (x, y, z), vector in theirs.items():
        assert tuple(made.vectors[where[x >> 3, y >> 3, z >> 3], x & 7, y & 7, z & 7].tolist()) == vector


def test_no_terms_change_nothing() -> None:
    field = some_field(1)
    assert np.array_equal(filtered(field, Terms((), ()), GRID, LATTICE).vectors, field.vectors)
    none = FixedField(np.zeros((0, 3), np.int32), np.zeros((0, 8, 8, 8, 3), np.int32))
    assert len(filtered(none, Terms((49,), (3,)), GRID, LATTICE).bricks) == 0


def quantised(frame: ForceField) -> FixedField:
    step = LATTICE.floor
    return FixedField(frame.bricks, (np.rint(frame.forces_n / LATTICE.unit_n / step) * step).astype(np.int32))


def test_fitted_terms_lower_the_error_and_pay() -> None:
    frame = smooth(0.02)
    decoded = quantised(frame)
    found = fitted(frame, decoded, LATTICE, 3000)
    assert found is not None
    before, after = (error_of(frame, f, LATTICE) for f in (decoded, found[1]))
    assert after < 0.9 * before
    assert worth(3000, before, after) > 2 * len(found[0].numbers)
    assert np.array_equal(found[1].vectors, filtered(decoded, found[0], GRID, LATTICE).vectors)
    assert fitted(frame, decoded, LATTICE, 5) is None  # a frame so small has no use for it
    few = fitted(frame, decoded, LATTICE, 3000, neighbours=4)
    assert few is not None and np.count_nonzero(few[0].weights()[0].any(axis=1)) <= 4
    assert clip_of(LATTICE) == 400


SPEC = TouchSpec(mode="nmse", step_n=0.1, effort="default")


def records(frames: list[ForceField], spec: TouchSpec) -> tuple[bytes, TouchDecoder, list[Any]]:
    encoder = TouchEncoder(GRID, spec)
    body = encoder.encode_segment(frames).body
    return (
        body,
        TouchDecoder(GRID, encoder.parameters),
        list(BodyReader(body, GRID, lossless=False).records(len(frames))),
    )


def test_frames_of_mode_nmse_have_one_and_other_decoders_follow() -> None:
    frames = [smooth(0.05), smooth(0.06)]
    body, decoder, told = records(frames, SPEC)
    assert any(one.filter for one in told)
    assert [one.cost.bits.total for one in told] == [8 * len(one.to_bytes()) for one in told]
    touch, _ = reference()
    import reference_decoder

    theirs = touch.decode_touch_body(body, 2, GRID.shape, GRID.spacing_m, TouchEncoder(GRID, SPEC).parameters)
    for mine, other in zip(decoder.frames(body, 2), theirs, strict=True):
        assert (mine.to_dense() + np.float32(0)).tobytes() == (
            reference_decoder.laid_out(other, GRID.shape) + np.float32(0)
        ).tobytes()


@pytest.mark.parametrize("spec", [replace(SPEC, effort="fast"), replace(SPEC, mode="mask"), TouchSpec()])
def test_others_have_none(spec: TouchSpec) -> None:
    _, _, told = records([smooth(0.05)], spec)
    assert not any(one.filter for one in told)


def test_an_empty_filter_is_refused() -> None:
    body, decoder, (told,) = records([smooth(0.05)], SPEC)
    assert told.filter
    at = body.index(told.to_bytes())
    payload = replace(told, filter=b"").to_bytes()
    forged = body[:at] + bytes([payload[0] | 128]) + payload[1:] + b"\0"
    with pytest.raises(CorruptFile):
        list(decoder.frames(forged, 1))
