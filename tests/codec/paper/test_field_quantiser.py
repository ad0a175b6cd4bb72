"""Field quantisers of the measures: their symbols agree with the quantisers they combine."""

from __future__ import annotations

import numpy as np
import pytest

from touchfield.codec.paper.field_quantiser import Components, FieldQuantiserSpec, Pairs
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid

SPEC_TEXTS = [
    "weber:0.1", "weber:0.25/octa3", "weber:0.1/none", "uniform:0.05", "lloyd-max:4/ico3", "components:0.02",
    "weber-components:0.1/31", "distinct",
]  # fmt: skip


@pytest.mark.parametrize("text", SPEC_TEXTS)
def test_symbols_are_equal_exactly_where_codewords_are(text: str, wavy_field: ForceField) -> None:
    spec = FieldQuantiserSpec.parse(text)
    assert FieldQuantiserSpec.parse(spec.text) == spec
    quantiser = spec.fit([wavy_field])
    symbols = quantiser(wavy_field)
    dense, vectors = symbols.to_dense().ravel(), wavy_field.to_dense().reshape(-1, 3)
    assert quantiser.alphabet > 1 and dense.min() >= 0 and dense.max() < quantiser.alphabet
    if text == "distinct":
        codewords = vectors + 0.0
    elif isinstance(quantiser, Components):
        table = quantiser.levels
        level = np.searchsorted(table.thresholds_n, np.abs(vectors), side="right")
        codewords = np.sign(vectors) * table.levels_n[level] + 0.0
    else:
        assert isinstance(quantiser, Pairs)
        table, codebook = quantiser.levels, quantiser.codebook
        amplitude = np.sqrt((vectors.astype(float) ** 2).sum(axis=1)).astype(np.float32)
        level = table.levels_n[table.encode(amplitude)] * (amplitude > 0)
        directions = np.ones((len(vectors), 1))
        if codebook is not None:
            directions = codebook.vertices[codebook.nearest(vectors)]
        codewords = level[:, None] * directions + 0.0
    _, symbol_ids = np.unique(dense, return_inverse=True)
    _, codeword_ids = np.unique(codewords, axis=0, return_inverse=True)
    pairs = np.unique(np.stack([symbol_ids, codeword_ids.ravel()]), axis=1)
    assert pairs.shape[1] == symbol_ids.max() + 1 == codeword_ids.max() + 1, (
        "one symbol to one codeword, both ways"
    )
    assert ((dense == 0) == ~codewords.any(axis=1)).all(), "0 is no force"


def test_a_symbol_array_is_as_sparse_as_its_field(wavy_field: ForceField) -> None:
    symbols = FieldQuantiserSpec.parse("weber:0.1").fit([wavy_field])(wavy_field)
    assert np.array_equal(symbols.bricks, wavy_field.bricks)
    positions = np.argwhere(symbols.to_dense())
    assert len(positions) == symbols.object_count < wavy_field.support_count, (
        "the weakest forces fall to zero"
    )
    assert np.array_equal(symbols.symbols_at(positions), symbols.to_dense()[tuple(positions.T)])
    assert (symbols.symbols_at([[-1, 0, 0], [0, 0, 99]]) == 0).all()


def test_a_force_beyond_the_quantiser_is_an_error(wavy_field: ForceField) -> None:
    quantiser = FieldQuantiserSpec.parse("weber:0.1").fit([wavy_field])
    with pytest.raises(InvalidArgument, match="made for"):
        quantiser(wavy_field.scaled(2))
    with pytest.raises(InvalidArgument, match="not seen"):
        FieldQuantiserSpec.parse("distinct").fit([wavy_field])(wavy_field.scaled(2))
    assert FieldQuantiserSpec.parse("weber:0.1").fit([], force_max_n=9.0)(wavy_field.scaled(2)).object_count


def test_an_empty_field_has_one_symbol() -> None:
    empty = ForceField.empty(Grid((9, 9, 9), (1, 1, 1), (0, 0, 0)))
    for text in SPEC_TEXTS:
        symbols = FieldQuantiserSpec.parse(text).fit([empty])(empty)
        assert symbols.object_count == 0 and not symbols.to_dense().any()


@pytest.mark.parametrize(
    "text",
    ["", "weber", "weber:", "weber:x", "weber:0.1/", "weber:2", "gauss:0.1", "lloyd-max:2.5", "lloyd-max:40",
     "uniform:0", "weber-components:0.1", "weber-components:0.1/0", "weber-components:0.1/x",
     "weber-components:0.1/512", "weber-components:1.5/31",
     "weber:0.1/ico99", "components:0.1/ico5", "components:-1", "weber:nan"],
)  # fmt: skip
def test_invalid_texts_are_refused(text: str) -> None:
    with pytest.raises(InvalidArgument):
        FieldQuantiserSpec.parse(text)


def test_a_step_may_be_as_fine_as_the_forces_allow(wavy_field: ForceField) -> None:
    fine = FieldQuantiserSpec.parse("uniform:1e-6/none")
    assert fine.fit([wavy_field.scaled(0.01)]).alphabet > 9000
    with pytest.raises(InvalidArgument, match="1 to 65536"):
        fine.fit([wavy_field])


def test_large_frame_is_subsampled_for_training(
    monkeypatch: pytest.MonkeyPatch, wavy_field: ForceField
) -> None:
    from touchfield.codec.paper import field_quantiser

    monkeypatch.setattr(field_quantiser, "_MAX_PER_FRAME", 50)
    monkeypatch.setattr(field_quantiser, "_MAX_TRAINING", 60)
    quantiser = FieldQuantiserSpec.parse("lloyd-max:3/none").fit([wavy_field, wavy_field.scaled(0.5)])
    assert quantiser.alphabet >= 8 and quantiser(wavy_field).object_count == wavy_field.support_count


def test_different_numbers_have_different_texts() -> None:
    texts = [FieldQuantiserSpec.parse(f"weber:0.1234567{i}").text for i in range(3)]
    assert len(set(texts)) == 3
    for bad in (-1.0, float("nan"), float("inf")):
        with pytest.raises(InvalidArgument):
            FieldQuantiserSpec().fit([], force_max_n=bad)
        with pytest.raises(InvalidArgument):
            FieldQuantiserSpec("lloyd-max", bad)


def test_too_fine_components_are_refused(wavy_field: ForceField) -> None:
    with pytest.raises(InvalidArgument, match="larger step"):
        FieldQuantiserSpec.parse("components:0.0001").fit([wavy_field])


@pytest.mark.parametrize("text", SPEC_TEXTS)
def test_quantising_a_codeword_returns_it(text: str, wavy_field: ForceField) -> None:
    quantiser = FieldQuantiserSpec.parse(text).fit([wavy_field], force_max_n=3.0)
    vectors = wavy_field.forces_n[wavy_field.mask]
    symbols = quantiser.symbols_of(vectors)
    if text.endswith("/none"):
        with pytest.raises(InvalidArgument, match="no direction"):
            quantiser.vectors_of(symbols)
        return
    decoded = quantiser.vectors_of(symbols)
    assert np.array_equal(quantiser.symbols_of(decoded), symbols), "what was decoded has the same symbols"
    assert not decoded[symbols == 0].any() and decoded[symbols > 0].any(axis=1).all()
    error = np.linalg.norm(decoded - vectors, axis=1) / np.linalg.norm(vectors, axis=1)
    assert np.median(error) <= (0 if text == "distinct" else 0.25)
    with pytest.raises(InvalidArgument, match="symbols"):
        quantiser.vectors_of(np.array([quantiser.alphabet], np.int32))


def test_weber_components_satisfy_the_mask_above_the_ladder_floor() -> None:
    field = ForceField.empty(Grid((8, 8, 8), (1, 1, 1), (0, 0, 0)))
    quantiser = FieldQuantiserSpec.parse("weber-components:0.1/31").fit([field], force_max_n=3.3)
    assert isinstance(quantiser, Components) and quantiser.alphabet == 63**3 < 2**18
    force_min_n = float(quantiser.levels.thresholds_n[0])
    assert 3.3 / force_min_n == pytest.approx((1.1 / 0.9) ** 31, rel=1e-4)  # 503 : 1
    rng = np.random.default_rng(4)
    x = rng.uniform(-3.3 / np.sqrt(3), 3.3 / np.sqrt(3), (20_000, 3)).astype(np.float32)
    error = np.linalg.norm(quantiser.vectors_of(quantiser.symbols_of(x)).astype(float) - x, axis=1)
    size = np.linalg.norm(x.astype(float), axis=1)
    above_floor = (np.abs(x) >= force_min_n).all(axis=1)
    assert 0.09 < (error[above_floor] / size[above_floor]).max() <= 0.1 + 1e-9
    assert (error <= 0.1 * size + np.sqrt(3) * force_min_n).all()
