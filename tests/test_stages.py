"""One battery for every registered coding stage: its claim is measured, its bytes make it again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from touchfield.codec.paper.directions import Codebook, codebook_names
from touchfield.codec.stage import Claim, Table, amplitude_quantisers, table_from_bytes
from touchfield.errors import CorruptFile, FormatError, InvalidArgument, TruncatedFile

ASKED = {
    "lloyd-max": [{"nq": 1}, {"nq": 4}, {"nq": 8}, {"nq": 12}],
    "weber": [{"k": 0.01}, {"k": 0.1}, {"k": 0.25, "criterion": "neighbours"}, {"k": 0.1, "force_max_n": 1.0}],
    "uniform": [{"step_n": 0.05}, {"step_n": 0.001}, {"step_n": 7.0}],
}
DATA = {
    "gamma": np.random.default_rng(0).gamma(2, 0.4, 20_000).clip(0, 3.3).astype(np.float32),
    "wide": np.geomspace(1e-3, 3.3, 20_000).astype(np.float32),
    "few": np.repeat(np.float32([0, 0.7, 3.3]), 100),
    "none": np.zeros(0, np.float32),
}
AMPLITUDES = [
    pytest.param(name, asked, data, id=f"{name}-{'-'.join(map(str, asked.values()))}-{data}")
    for name in ASKED
    for asked in ASKED[name]
    for data in DATA
]
CODEBOOKS = ["ico1", "ico2", "ico3", "ico3-flat", "ico5", "ico8-flat", "ico20", "octa1", "octa3", "octa5"]


def fitted(name, asked, data):
    return amplitude_quantisers()[name](**asked).fit(DATA[data])


def test_every_registered_quantiser_is_in_the_battery():
    assert set(amplitude_quantisers()) == set(ASKED)
    assert set(CODEBOOKS) <= set(codebook_names())


@pytest.mark.parametrize(("name", "asked", "data"), AMPLITUDES)
def test_an_amplitude_stage_keeps_its_claim(name, asked, data):
    table = fitted(name, asked, data)
    claim = table.claim
    spread = np.linspace(0, 4, 30_001, dtype=np.float32)
    values = np.concatenate([DATA[data], spread, table.levels_n, table.thresholds_n])
    decoded = table.decode(table.encode(values))
    assert claim.kind in ("absolute", "relative")
    assert claim.worst(values, decoded) <= claim.bound
    if len(table.levels_n) > 2:  # and the claim is not idle
        assert claim.worst(values, decoded) >= 0.9 * claim.bound


@pytest.mark.parametrize(("name", "asked", "data"), AMPLITUDES)
def test_decoded_amplitudes_are_coded_as_themselves(name, asked, data):
    table = fitted(name, asked, data)
    symbols = np.arange(len(table.levels_n), dtype=np.uint16)
    np.testing.assert_array_equal(table.encode(table.decode(symbols)), symbols)


@pytest.mark.parametrize(("name", "asked", "data"), AMPLITUDES)
def test_a_table_is_made_again_from_its_bytes(name, asked, data):
    table = fitted(name, asked, data)
    again = Table.from_bytes(table.to_bytes())
    assert type(again) is type(table)
    assert again.claim == table.claim
    np.testing.assert_array_equal(again.levels_n, table.levels_n)
    np.testing.assert_array_equal(again.thresholds_n, table.thresholds_n)
    assert again.to_bytes() == table.to_bytes()


@pytest.mark.parametrize("name", ASKED)
def test_every_table_cut_short_or_lengthened_is_refused(name):
    data = fitted(name, ASKED[name][0], "gamma").to_bytes()
    for end in range(len(data)):
        with pytest.raises(TruncatedFile):
            table_from_bytes(data[:end])
    with pytest.raises(CorruptFile):
        table_from_bytes(data + b"\0")


@given(st.binary(max_size=40))
def test_any_bytes_make_a_table_or_a_format_error(data):
    try:
        table = table_from_bytes(data)
    except FormatError:
        return
    levels = table.levels_n
    assert len(levels) <= 65536 and np.isfinite(levels).all() and levels[0] >= 0 and (np.diff(levels) > 0).all()
    assert table.to_bytes() == data


@given(st.sampled_from([0, 1, 2]), st.binary(min_size=10, max_size=19))
def test_any_bytes_of_a_known_kind_make_a_table_or_a_format_error(kind, data):
    try:
        levels = table_from_bytes(bytes([kind]) + data).levels_n
    except FormatError:
        return
    assert np.isfinite(levels).all() and levels[0] >= 0 and (np.diff(levels) > 0).all()


@pytest.mark.parametrize("bad", [[1.0, 1.0], [2.0, 1.0], [-1.0, 1.0], [0.0, np.nan], [0.0, np.inf]])
def test_levels_that_do_not_ascend_are_corrupt(bad):
    data = b"\0\1\0" + np.array(bad, "<f4").tobytes()
    with pytest.raises(CorruptFile, match="levels"):
        table_from_bytes(data)


@pytest.mark.parametrize("name", ASKED)
def test_a_level_that_there_is_not_is_corrupt(name):
    table = fitted(name, ASKED[name][0], "few")
    with pytest.raises(CorruptFile, match="level"):
        table.decode(np.array([0, len(table.levels_n)], np.uint16))


@pytest.mark.parametrize("name", ASKED)
def test_tables_are_read_only(name):
    table = fitted(name, ASKED[name][0], "gamma")
    with pytest.raises(ValueError, match="read-only"):
        table.levels_n[0] = 1.0


# -- direction codebooks --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CODEBOOKS)
def test_a_codebook_keeps_its_claim(name):
    codebook = Codebook.get(name)
    a, b, c = (codebook.vertices[codebook.faces[:, i]] for i in range(3))
    holes = np.cross(b - a, c - a)
    holes *= np.sign((holes * a).sum(axis=1))[:, None]
    random = np.random.default_rng(0).normal(size=(50_000, 3)) * 10.0 ** np.linspace(-30, 30, 50_000)[:, None]
    values = np.concatenate([random, holes]).astype(np.float32)
    worst = codebook.claim.worst(values, codebook.decode(codebook.encode(values)))
    assert codebook.claim.kind == "angle"
    assert 0.999 * codebook.claim.bound <= worst <= codebook.claim.bound


@pytest.mark.parametrize("name", codebook_names())
def test_a_codebook_is_made_again_from_its_bytes(name):
    data = Codebook.get(name).to_bytes()
    assert Codebook.from_bytes(data) is Codebook.get(name)
    for end in range(len(data)):
        with pytest.raises(TruncatedFile):
            Codebook.from_bytes(data[:end])


@pytest.mark.parametrize("data", [b"\4ico5x", b"\0", b"\4icox", b"\2\xff\xff"])
def test_bytes_that_name_no_codebook_are_corrupt(data):
    with pytest.raises(CorruptFile):
        Codebook.from_bytes(data)


def test_a_direction_that_there_is_not_is_corrupt():
    codebook = Codebook.get("ico3")
    with pytest.raises(CorruptFile, match="below 92"):
        codebook.decode(np.array([92], np.uint16))
    with pytest.raises(CorruptFile):
        codebook.amplitude_for_direction(np.ones((1, 3), np.float32), np.array([500], np.uint16))


# -- the claim itself -----------------------------------------------------------------------------------------


def test_a_claim_measures_what_it_says():
    x, y = np.array([1.0, 2.0, 4.0]), np.array([1.5, 2.0, 3.0])
    assert Claim("absolute").worst(x, y) == 1.0
    assert Claim("relative").worst(x, y) == 0.5
    assert Claim("relative", low=2.0, high=3.0).worst(x, y) == 0.0
    assert Claim("lossless").worst(x, x) == 0.0
    east, north = np.array([[1.0, 0, 0]]), np.array([[0, 2.0, 0]])
    assert Claim("angle").worst(east, north) == pytest.approx(np.pi / 2)
    with pytest.raises(InvalidArgument):
        Claim("perfect")
