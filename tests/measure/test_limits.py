"""All coding limits of a medium, and refused arguments."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from limits_makers import context_entropy, fields_of, sparse
from touchfield.codec.paper.field_quantiser import FieldQuantiserSpec
from touchfield.errors import InvalidArgument
from touchfield.measure.estimators import binary_entropy_bits
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.measure.limits import coding_limits
from touchfield.medium import ForceField, Grid

pytestmark = pytest.mark.filterwarnings("ignore::touchfield.measure.quantity.FewSamplesWarning")


def test_coding_limits_agree_with_separate_measures(wavy_field: ForceField) -> None:
    moved = wavy_field.scaled(0.9)
    quantiser = FieldQuantiserSpec.parse("weber:0.25/ico3").fit([wavy_field])
    frames = [quantiser(wavy_field), quantiser(moved)]
    found = coding_limits(frames)
    dense = np.stack([f.to_dense() for f in frames])
    p = np.count_nonzero(dense) / dense.size
    assert (found.frame_count, found.voxels, found.supported) == (2, dense.size, np.count_nonzero(dense))
    identity = binary_entropy_bits(p) + p * found.object_entropy.value
    assert found.voxel_entropy.value == pytest.approx(identity, abs=1e-12)
    for context in found.contexts:
        separate = context_entropy(frames, context.neighbourhood, previous_frame=context.previous_frame)
        assert separate == context and context.per_voxel.value <= found.voxel_entropy.value
    summary = json.loads(json.dumps(found.summary(), allow_nan=False))
    support_count = np.count_nonzero(dense)
    assert (
        summary["supported_voxels"] == support_count
        and summary["object_entropy_bits"] == found.object_entropy.value
    )
    limit = summary["voxel_entropy"]
    assert limit["bits_per_frame"] == pytest.approx(limit["bits_per_voxel"] * dense.size / 2)
    assert limit["bits_per_supported_voxel"] == pytest.approx(
        limit["bits_per_voxel"] * dense.size / support_count
    )
    before = np.pad(dense, [(0, 0)] * 3 + [(1, 0)])[..., :-1]
    times = np.unique(np.stack([dense, before], axis=-1).reshape(-1, 2), axis=0, return_counts=True)[1]
    previous = found.context("previous")
    assert (previous.cells, previous.once) == (len(times), np.count_nonzero(times == 1))
    assert not replace(previous, informed=10 * previous.cells).is_diluted
    assert coding_limits(fields_of(np.ones((1, 4, 4, 4), int), 2)).voxel_entropy.symbols == 1  # none is empty
    with pytest.raises(KeyError):
        found.context("none")


@pytest.mark.parametrize(
    ("shape", "axis"),
    [((32, 20, 1), "y"), ((40, 1, 1), "x"), ((1, 40, 1), "y"), ((9, 1, 11), "z"), ((1, 1, 1), "z")],
)
def test_flat_media_are_scanned_along_the_last_axis_that_has_samples(
    shape: tuple[int, ...], axis: str
) -> None:
    """A flat array of actuators has the limits of the array without its axis of one sample."""
    x = sparse((2, *shape), 4, 0.6)
    x = np.maximum.accumulate(x, axis=1 + "xyz".index(axis))  # neighbours along the lines are informative
    found = coding_limits(fields_of(x, 4))
    assert found.scan_axis == found.summary()["scan_axis"] == axis
    dense = x if axis == "z" else x.reshape(2, *(1,) * shape.count(1), *(n for n in shape if n > 1))
    for context in found.contexts:
        assert context == context_entropy(
            fields_of(x, 4), context.neighbourhood, previous_frame=context.previous_frame
        )
        alone = context_entropy(
            fields_of(dense, 4), context.neighbourhood, previous_frame=context.previous_frame
        )
        assert context.per_voxel.value == pytest.approx(alone.per_voxel.value, abs=1e-12)
        assert (context.contexts, context.cells) == (alone.contexts, alone.cells)
    if max(shape) > 1:
        assert found.context("previous").per_voxel.value < 0.9 * found.voxel_entropy.value


def test_empty_medium_has_zero_entropy_and_a_note() -> None:
    empty = FieldSymbols(Grid((64, 64, 64), (1, 1, 1), (0, 0, 0)), np.zeros((0, 3), np.int32),
                         np.zeros((0, 8, 8, 8), np.int32), 1, "test")  # fmt: skip
    found = coding_limits([empty, empty])
    assert found.voxel_entropy.value == 0 and math.isnan(found.object_entropy.value)
    assert found.object_entropy.notes
    assert all(c["bits_per_supported_voxel"] is None for c in found.summary()["contexts"].values())
    json.dumps(found.summary(), allow_nan=False)


def test_nominal_lattice_is_never_dense() -> None:
    """8 x 10^9 voxels, one brick of symbols: empty space in closed form."""
    symbols = np.zeros((1, 8, 8, 8), np.int32)
    symbols[0, 2:5, 3, 1] = [1, 2, 1]
    grid = Grid((2909, 2182, 1273), (1e-3,) * 3, (0, 0, 0))
    found = coding_limits(FieldSymbols(grid, np.int32([[100, 7, 150]]), symbols, 3, "test"))
    assert found.voxels == grid.voxel_count and found.supported == 3
    assert found.context("corner").per_voxel.samples == grid.voxel_count


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: coding_limits(7), "int"),
        (lambda: coding_limits([1, 2]), "FieldSymbols"),
        (lambda: coding_limits([]), "no frame"),
    ],
)  # fmt: skip
def test_invalid_arguments_are_refused(call: object, message: str) -> None:
    with pytest.raises(InvalidArgument, match=message):
        call()


def test_frames_that_do_not_match_are_refused() -> None:
    a = fields_of(np.ones((1, 4, 4, 4), int), 2)[0]
    for other in (
        fields_of(np.ones((1, 4, 4, 5), int), 2)[0],
        fields_of(np.ones((1, 4, 4, 4), int), 3)[0],
        FieldSymbols(a.grid, a.bricks, a.symbols, 2, "another"),
    ):
        with pytest.raises(InvalidArgument, match=r"grid|quantiser"):
            coding_limits([a, other])


def test_cells_beyond_the_memory_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_MEMORY_GIB", "0.0005")
    with pytest.raises(InvalidArgument, match="coarser quantiser"):
        context_entropy(
            fields_of(np.random.default_rng(0).integers(0, 10**6, (1, 30, 30, 30)), 10**6), "corner"
        )
