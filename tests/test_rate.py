"""The small parts of bench/rate.py: the search for an equal error, symbols within the bound, layouts."""

from __future__ import annotations

import importlib
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

BENCH = Path(__file__).resolve().parents[1] / "bench"
F0_N = 0.05


def bench_module(name: str) -> Any:
    if str(BENCH) not in sys.path:
        sys.path.insert(0, str(BENCH))
    return importlib.import_module(name)


lattices, ours, peers = (bench_module(f"rate_{name}") for name in ("symbols", "ours", "peers"))
fields, pool, sources = (bench_module(f"rate_{name}") for name in ("fields", "pool", "source"))
reports = bench_module("rate")


def forces(seed: int, longest_n: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(1, 9, 7, 5, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    size = longest_n * rng.random((1, 9, 7, 5, 1)) ** 3
    size[rng.random(size.shape) < 0.4] = 0
    return (size * direction).astype(np.float32)


@given(st.integers(0, 10**6), st.sampled_from([0.04, 0.3, 3.3]))
def test_every_lattice_of_the_peers_keeps_the_error_bound(seed, longest_n):
    x = forces(seed, longest_n)
    results = lattices.promised(x)
    assert len(results) == 2
    for result in results:
        assert lattices.is_within_bound(x, result.decoded)
        is_supported = (result.symbols != 0).any(axis=-1)
        assert not result.decoded[~is_supported].any()  # a decoder has no force where all symbols are 0
        assert not is_supported[np.linalg.norm(x, axis=-1) <= F0_N].any()


def test_a_lattice_coarser_than_the_mask_is_detected():
    x = forces(1, 3.3)
    assert not lattices.is_within_bound(x, lattices.uniform(x, 4 * F0_N).decoded)


@given(st.integers(0, 10**6))
def test_companding_has_an_inverse(seed):
    x = forces(seed, 3.3)
    assert np.allclose(lattices.expand(lattices.compand(x)), x, rtol=1e-5, atol=1e-7)


@given(st.integers(0, 10**6), st.integers(3, 60))
def test_octahedral_map_has_the_stated_resolution(seed, side):
    unit = np.random.default_rng(seed).normal(size=(500, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    u, v, direction = lattices.octahedral(unit, side)
    assert u.min() >= 0 and v.min() >= 0 and max(u.max(), v.max()) < side
    assert np.allclose(np.linalg.norm(direction, axis=1), 1)
    angle = 2 * np.arcsin(np.linalg.norm(direction - unit, axis=1).max() / 2)
    assert angle < 4.2 / (side - 1)


def test_an_unreachable_error_has_no_bytes():
    assert math.isnan(ours.Search(lambda step: (-5.0, 100.0), -20.0, 0.1).run().size())


def test_interpolation_is_of_the_logarithm():
    assert ours.interpolated([(1000, -20.0), (100, -10.0)], -15.0) == pytest.approx(10**2.5)


@given(st.floats(-45, -5), st.floats(0.01, 1.0), st.floats(12, 28), st.floats(-0.2, -0.05))
@example(-5.75, 0.5, 19.0, -0.125)
def test_search_needs_few_trials(target_db, start, db_a_decade, slope):
    def code(step: float) -> tuple[float, float]:
        db = db_a_decade * math.log10(step)
        return db, 1000 * math.exp(slope * db)

    found = ours.Search(code, target_db, start).run()
    off = 1.001 * math.expm1(-slope * ours.TOLERANCE_DB)  # one trial that is near enough ends the search
    assert found.size() == pytest.approx(1000 * math.exp(slope * target_db), rel=off)
    assert found.step() == pytest.approx(10 ** (target_db / db_a_decade), rel=0.06)
    assert len(found.tried) <= 5


def test_a_search_that_jumps_stays_between_its_trials():
    def code(step: float) -> tuple[float, float]:
        coarse = step > 0.1
        return (-10.0, 100.0) if coarse else (-30.0, 1000.0)

    found = ours.Search(code, -20.0, 0.7).run()
    assert len(found.tried) <= 7
    assert found.size() == pytest.approx(math.sqrt(1e5))


def test_a_search_continues_for_non_monotonic_errors():
    def code(step: float) -> tuple[float, float]:
        noise = 0.8 if 0.365 < step < 0.375 else 0.0
        return 20 * math.log10(step) - 12.62 - noise, 130 / step

    found = ours.Search(code, -21.4, 0.3605).run()
    assert found.size() == pytest.approx(130 / 10 ** (-8.78 / 20), rel=0.05)


def test_symbols_of_coder_paper_are_those_it_codes(wavy_field):
    symbols, table_bytes = ours.paper_symbols([wavy_field, wavy_field])
    dense = wavy_field.to_dense()[fields.box([wavy_field])]
    assert symbols.shape == (2, *dense.shape[:3], 2)
    assert table_bytes == 4 * 2**6
    assert np.array_equal(symbols[0, ..., 0] > 0, dense.any(axis=-1))
    assert symbols[..., 0].max() <= 2**6 and symbols[..., 1].max() < 258
    assert not symbols[..., 1][symbols[..., 0] == 0].any()
    found = peers.on_paper([wavy_field])
    assert "JPEG XL" not in found and found["xz"] > table_bytes


def test_stored_figures_are_found_by_their_inputs(tmp_path):
    figures = {"bytes": 7, "peers": {"zfp": math.nan}}
    pool.cached(tmp_path / "new", ["tum band, nw 6", 1], lambda: figures)
    again = pool.cached(tmp_path / "new", ["tum band, nw 6", 1], lambda: pytest.fail("it is kept"))
    assert again["bytes"] == 7 and math.isnan(again["peers"]["zfp"])
    assert pool.cached(tmp_path / "new", ["tum band, nw 6", 2], lambda: {"bytes": 8}) == {"bytes": 8}
    assert len({pool.fingerprint(part) for part in ("fields", "peers", "ours")}) == 3


def test_layouts_contain_every_symbol():
    symbols = np.random.default_rng(0).integers(-3, 4, (2, 4, 3, 5, 3)).astype(np.int32)
    symbols[:, :, 0] = 0
    supported = int((symbols != 0).any(axis=-1).sum())
    union = int((symbols != 0).any(axis=(0, -1)).sum())
    layouts = list(peers.layouts(symbols))
    expected = [symbols.size] * 2 + [3 * supported] * 2 + [6 * union] * 3
    assert [len(data) for data, _ in layouts] == expected
    assert [mask is None for _, mask in layouts] == [True] * 2 + [False] * 5


def test_wide_symbols_lose_nothing():
    symbols = np.array([[-300, 5, 299]], np.int32)
    assert peers.plain(symbols).dtype == np.int16
    low, high = np.frombuffer(peers.byte_planes(peers.plain(symbols)), np.uint8).reshape(2, 3)
    assert np.array_equal((low | high.astype(np.uint16) << 8).astype(np.int16), symbols[0])


def test_lossless_sizes_fall_with_the_entropy():
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


def row(at, touch, *, frames=1, ratio=None, peer=300.0, beyond=0):
    return {
        "field": "tum band, nw 7",
        "kind": "band",
        "at": at,
        "frames": frames,
        "nmse_db": -20.0,
        "beyond": beyond,
        "touch": touch,
        "p_over_i": {} if ratio is None else {"default": ratio},
        "peers": {"xz": peer},
    }


def report_of(*rows, speeds=()):
    former = {"tum band, nw 7": {"default": 100.0}}
    before = {
        "promise": former,
        "NMSE": former,
        "p_over_i, promise": {"tum band, nw 7": 0.5},
        "p_over_i, NMSE": {},
    }
    return reports.Report(reports.EFFORTS, before, list(rows), list(speeds))


@pytest.mark.parametrize(("size", "met"), [(99.0, True), (101.0, False)])
def test_bars_compare_with_the_previous_figures(size, met):
    found = report_of(row("promise", {"default": size}))
    bars = {(bar["limit"], bar["met"]) for bar in found.bars() if bar["measured"] is not None}
    assert bars == {(1.0, met), (1.0, True), (0, True)}
    assert found.ranges()["default, promise, 1 frame"] == [300 / size] * 2


def test_bytes_at_another_error_than_before_are_not_compared():
    found = report_of(row("NMSE", {"default": 100.0}))
    means = [bar for bar in found.bars() if bar["limit"] == 1.0 and "former default" in bar["bar"]]
    assert [bar["measured"] for bar in means] == [None, 1.0]
    found.before["NMSE"]["tum band, nw 7"]["nmse_db"] = -19.0
    assert {bar["measured"] for bar in found.bars() if "former" in bar["bar"]} == {None}


def test_unmeasured_bars_are_neither_met_nor_missed():
    assert {(bar["measured"], bar["met"]) for bar in report_of().bars()} == {(None, None)}


def test_later_frames_violations_and_speeds_have_bars():
    speeds = [
        {"field": "tum band, nw 7", "effort": "default", "encode_frames_s": 11.0, "decode_frames_s": 61.0}
    ]
    found = report_of(row("promise", {}, frames=5, ratio=0.6, beyond=2), speeds=speeds).bars()
    bars = {(round(b["measured"], 9), b["limit"], b["met"]) for b in found if b["measured"] is not None}
    assert bars == {(1.2, 1.0, False), (2, 0, False), (61.0, 60, True), (11.0, 12, False)}


def test_tables_list_a_peer_next_to_our_figures():
    text = "\n".join(report_of(row("promise", {"default": 200.0})).tables())
    line = next(line for line in text.splitlines() if line.startswith("tum band"))
    assert line.split()[-4:-2] == ["1.5", "-"]


def test_patches_leave_no_error_beyond_the_mask_or_the_target():
    pytest.importorskip("imagecodecs")
    x = forces(3, 3.3)
    assert sources.patch_bytes(x, x, None) == sources.patch_bytes(x, x, -60.0) == 0
    other = x.copy()
    other[0, 2:5] += 0.3
    assert 0 < sources.patch_bytes(x, other, -20.0) < sources.patch_bytes(x, other, None)


def test_a_shrunk_map_is_the_median_of_known_values():
    maps = np.array([[[0, 0, 7, 9], [0, 5, 8, 100]]], np.int32)
    assert sources.shrunk(maps, 2).tolist() == [[[0, 9]]]


@pytest.mark.parametrize("kind", ["band", "height"])
def test_the_exact_map_reproduces_the_field(kind, tmp_path):
    case = next((c for c in fields.cases((4,)) if c.kind == kind and c.has_maps), None)
    if case is None:
        pytest.skip("no ../shared/data")
    frames = case.frames(tmp_path)[:2]
    source = sources.Source(case, 2)
    for found, expected in zip(source.frames(source.maps, 1), frames, strict=True):
        assert np.array_equal(found.to_dense(), expected.to_dense())
    assert not np.array_equal(source.frames(3 * (source.maps // 3), 1)[0].to_dense(), frames[0].to_dense())
