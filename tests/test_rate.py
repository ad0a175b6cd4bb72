"""The small parts of bench/rate.py: the search for an equal error, symbols that keep the promise, layouts."""

from __future__ import annotations

import importlib
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

BENCH = Path(__file__).resolve().parents[1] / "bench"
K, F0_N = 0.1, 0.05


def bench_module(name: str) -> Any:
    if str(BENCH) not in sys.path:
        sys.path.insert(0, str(BENCH))
    return importlib.import_module(name)


lattices, ours, tables = (bench_module(f"rate_{name}") for name in ("symbols", "ours", "tables"))
peers, fields = bench_module("rate_peers"), bench_module("rate_fields")
search, contest, kept = bench_module("rate_search"), bench_module("rate_contest"), bench_module("rate_keep")


def forces(seed: int, longest_n: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(1, 9, 7, 5, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    size = longest_n * rng.random((1, 9, 7, 5, 1)) ** 3
    size[rng.random(size.shape) < 0.4] = 0
    return (size * direction).astype(np.float32)


@given(st.integers(0, 10**6), st.sampled_from([0.04, 0.3, 3.3]))
def test_every_lattice_of_the_peers_keeps_the_promise(seed, longest_n):
    x = forces(seed, longest_n)
    made = lattices.promised(x, K, F0_N)
    assert len(made) == 4
    for one in made:
        assert lattices.is_kept(x, one.decoded, K, F0_N), one.name
        held = (one.symbols != 0).any(axis=-1)
        assert not one.decoded[~held].any(), one.name  # a decoder knows no force where all symbols are 0
        assert not held[np.linalg.norm(x, axis=-1) <= F0_N].any(), one.name


def test_a_lattice_coarser_than_the_mask_is_found_out():
    x = forces(1, 3.3)
    assert not lattices.is_kept(x, lattices.uniform(x, 4 * F0_N).decoded, K, F0_N)


@given(st.integers(0, 10**6))
def test_companding_has_an_inverse(seed):
    x = forces(seed, 3.3)
    assert np.allclose(lattices.expand(lattices.compand(x, K, F0_N), K, F0_N), x, rtol=1e-5, atol=1e-7)


@given(st.integers(0, 10**6), st.integers(3, 60))
def test_octahedral_map_is_as_fine_as_is_said(seed, side):
    unit = np.random.default_rng(seed).normal(size=(500, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    u, v, direction = lattices.octahedral(unit, np.full(len(unit), side))
    assert u.min() >= 0 and v.min() >= 0 and max(u.max(), v.max()) < side
    assert np.allclose(np.linalg.norm(direction, axis=1), 1)
    angle = 2 * np.arcsin(np.linalg.norm(direction - unit, axis=1).max() / 2)
    assert angle < 4.2 / (side - 1)


def test_bytes_at_an_equal_error_are_found_between_trials():
    def code(step: float) -> tuple[float, float]:
        return 1000 / step, 20 * math.log10(step)

    for target in (-37.0, -12.3, 3.0):
        expected = 1000 / 10 ** (target / 20)
        assert ours.at_error(code, target, 0.07) == pytest.approx(expected, rel=1e-3)


def test_an_error_that_no_step_reaches_has_no_bytes():
    assert math.isnan(ours.at_error(lambda step: (100, -5.0), -20.0, 0.1))


def test_interpolation_is_of_the_logarithm():
    assert ours.interpolated([(1000, -20.0), (100, -10.0)], -15.0) == pytest.approx(10**2.5)


@given(st.floats(-45, -5), st.floats(0.01, 1.0), st.floats(12, 28), st.floats(-0.2, -0.05))
def test_search_needs_few_trials(target_db, start, db_a_decade, slope):
    def code(step: float) -> tuple[float, float]:
        db = db_a_decade * math.log10(step)
        return db, 1000 * math.exp(slope * db)

    found = search.Search(code, target_db, start).run()
    assert found.size() == pytest.approx(1000 * math.exp(slope * target_db), rel=0.003)
    assert found.step() == pytest.approx(10 ** (target_db / db_a_decade), rel=0.06)
    assert len(found.tried) <= 5


def test_one_trial_near_the_error_is_carried_along_the_slope():
    found = search.Search(lambda _: (-20.3, 500.0, 0.0), -20.0, 0.1, near_db=0.4, slope=-0.2).run()
    assert len(found.tried) == 1
    assert found.size() == pytest.approx(500 * math.exp(-0.06))
    assert found.size(1) == 0  # bits of later frames, where there are none


def test_a_search_that_jumps_stays_between_its_trials():
    def code(step: float) -> tuple[float, float]:
        coarse = step > 0.1
        return (-10.0, 100.0) if coarse else (-30.0, 1000.0)

    found = search.Search(code, -20.0, 0.7).run()
    assert len(found.tried) <= 7
    assert found.size() == pytest.approx(math.sqrt(1e5))


def test_a_search_goes_on_where_errors_do_not_follow_the_steps_in_order():
    def code(step: float) -> tuple[float, float]:
        noise = 0.8 if 0.365 < step < 0.375 else 0.0
        return 20 * math.log10(step) - 12.62 - noise, 130 / step

    found = search.Search(code, -21.4, 0.3605).run()
    assert found.size() == pytest.approx(130 / 10 ** (-8.78 / 20), rel=0.05)


def test_symbols_of_coder_paper_are_those_it_codes(wavy_field):
    symbols, table_bytes = ours.paper_symbols([wavy_field, wavy_field])
    assert symbols.shape == (2, *wavy_field.grid.shape, 2)
    assert table_bytes == 4 * 2**6
    assert np.array_equal(symbols[0, ..., 0] > 0, wavy_field.to_dense().any(axis=-1))
    assert symbols[..., 0].max() <= 2**6 and symbols[..., 1].max() < 258
    assert not symbols[..., 1][symbols[..., 0] == 0].any()
    found = contest.peers_on_paper([wavy_field])
    assert "JPEG XL" not in found and found["xz"] > table_bytes


def test_kept_figures_are_found_by_what_they_depend_on(tmp_path):
    folder = kept.Keep(tmp_path / "new")
    folder.put("tum band, nw 6-equal", ["a", 1], {"bytes": 7, "peers": {"zfp": math.nan}})
    again = kept.Keep(tmp_path / "new").get("tum band, nw 6-equal", ["a", 1])
    assert again["bytes"] == 7 and math.isnan(again["peers"]["zfp"])
    assert folder.get("tum band, nw 6-equal", ["a", 2]) is None
    assert len({kept.fingerprint(what) for what in ("fields", "peers", "ours")}) == 3


def test_layouts_hold_every_symbol():
    symbols = np.random.default_rng(0).integers(-3, 4, (2, 4, 3, 5, 3)).astype(np.int32)
    symbols[:, :, 0] = 0
    held = int((symbols != 0).any(axis=-1).sum())
    union = int((symbols != 0).any(axis=(0, -1)).sum())
    sizes = {name: len(data) for name, data, _ in peers.layouts(symbols)}
    assert sizes["box, in turn"] == sizes["box, planes"] == symbols.size
    assert sizes["list, in turn"] == sizes["list, planes"] == 3 * held
    assert sizes["list, frames in turn"] == sizes["list, changes in turn"] == 6 * union
    assert [m is None for _, _, m in peers.layouts(symbols)][:2] == [True, True]


def test_wide_symbols_lose_nothing():
    symbols = np.array([[-300, 5, 299]], np.int32)
    assert peers.plain(symbols).dtype == np.int16
    low, high = np.frombuffer(peers._bytes(peers.plain(symbols)), np.uint8).reshape(2, 3)
    assert np.array_equal((low | high.astype(np.uint16) << 8).astype(np.int16), symbols[0])


def test_lossless_sizes_fall_with_what_there_is_to_say():
    rng = np.random.default_rng(2)
    noise = rng.integers(-7, 8, (1, 16, 16, 16, 3)).astype(np.int32)
    even = np.ones_like(noise)
    assert peers.lossless(even)["xz"] < peers.lossless(noise)["xz"] / 10


def test_a_volume_is_cut_to_its_forces(wavy_field):
    volume = fields.Volume.of([wavy_field])
    assert np.isclose(volume.energy, (wavy_field.to_dense().astype(float) ** 2).sum())
    assert volume.forces_n.shape[1] <= wavy_field.grid.shape[0]
    assert volume.nmse_db(volume.forces_n * np.float32(0.9)) == pytest.approx(-20, abs=1e-3)


def test_a_band_is_four_voxels_thick():
    case = next(c for c in fields.cases((6,)) if c.kind == "band")
    assert case.spec.thickness_m == pytest.approx(4 * (0.16 + 0.12 + 0.07) / 3 / 64)


@pytest.mark.parametrize(
    ("value", "bar", "most", "told"),
    [(2.0, 2.0, False, "yes"), (1.9, 2.0, False, "NO"), (0.7, 0.75, True, "yes"), (1.0, None, False, "-")],
)
def test_bars(value, bar, most, told):
    assert tables.met(value, bar, most=most) == told


def test_a_table_is_in_columns(capsys):
    table = tables.Table("title", ("field", "bytes"))
    table.add(("long name", "1"), bytes=1)
    table.add(("x", "12,345"), bytes=12345)
    lines = str(table).splitlines()
    assert lines[1] == "title" and len(lines[4]) == len(lines[5])
    assert [row["bytes"] for row in table.kept] == [1, 12345]
    assert "long name" in capsys.readouterr().err
