"""The golden queries of `conformance/queries`: the reference, the package, C in several builds, WebAssembly.

`touch.h` answers at frames, `touch_query.h`, on which package, engines and page build, at any time. Its
programs get the memory of a receiver for each pair of frames, as `FieldSampler` writes it.
"""

from __future__ import annotations

import base64
import gzip
import importlib
import re
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from shutil import which
from typing import Any

import numpy as np
import pytest
from second import CONFORMANCE
from test_c import COMPILER, built, run_with
from test_ticks import OF_THE_PAGE, SANITIZERS, wasm_module

import touchfield as tf
from touchfield.compute.native import native
from touchfield.filters.resample import half_grid, rebuild_level
from touchfield.medium import Grid, HapticMedium
from touchfield.medium.deformation import Deformation
from touchfield.render.sampler import FieldSampler
from touchfield.viewer.browser import empty_page

queries: Any = importlib.import_module("queries")
make_queries: Any = importlib.import_module("make_queries")

FOLDER = Path(__file__).parent
FILES = sorted((CONFORMANCE / "queries").glob("*.csv"))
NODE = which("node")
STREAMS = [
    path for path in FILES if path.stem not in ("coarse", "deformed")
]  # what a decoder alone can answer
any_file = pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
any_stream = pytest.mark.parametrize("path", STREAMS, ids=lambda path: path.stem)
needs_c = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler here")


opened = ExitStack()


@pytest.fixture(scope="module", autouse=True)
def closed_streams() -> Iterator[None]:
    """Close the streams of `sampler_of` at the end."""
    with opened:
        yield
        sampler_of.cache_clear()


@cache
def golden(path: Path) -> Any:
    """A file of golden queries."""
    return queries.Queries.read(path)


@cache
def sampler_of(path: Path) -> FieldSampler:
    """The package's receiver of the same medium."""
    own, deformation = golden(path), None
    stream = opened.enter_context(tf.open_stream(own.stream))
    medium: Any = stream.medium if stream.scene is None else stream.scene
    if "lattice" in own.stated:
        coarse, shape = medium, tuple(map(int, own.stated["lattice"].split()))
        grid = Grid(shape, tuple(h / 2 for h in coarse.grid.spacing_m), coarse.grid.origin_m)
        assert half_grid(grid) == coarse.grid
        frames = [rebuild_level(field, grid) for field in coarse]
        medium = HapticMedium.from_frames(frames, coarse.rate_hz)
    if "deformation" in own.stated:
        with np.load(path.parent / own.stated["deformation"]) as arrays:
            track = (arrays[name] for name in ("displacement_m", "corner_m", "spacing_m"))
            deformation = Deformation(*track, rate_hz=medium.rate_hz)  # type: ignore[arg-type]
    return FieldSampler(medium, deformation=deformation)


def answers_of(rows: np.ndarray) -> Any:
    """Answers from rows of fourteen numbers."""
    return queries.Answers(rows[:, :3], rows[:, 3:12].reshape(-1, 3, 3), rows[:, 12:])


def require(path: Path, found: Any, rows: Any = slice(None)) -> None:
    """Require the golden answers."""
    own = golden(path)
    assert own.agrees(found, rows), f"{path.stem}: {own.differences(found, rows)} beyond {own.tolerances}"


# -- what is in the files ----------------------------------------------------------------------------------


def test_files_are_those_of_the_script_and_small() -> None:
    assert {path.stem for path in FILES} == set(make_queries.CASES)
    assert sum(path.stat().st_size for path in (CONFORMANCE / "queries").iterdir()) < 200_000


@any_file
def test_the_reference_computes_the_golden_queries(path: Path) -> None:
    own = golden(path)
    rows = slice(0, None, 5)
    require(path, queries.answer(own.medium, own.rows[rows, 0], own.rows[rows, 1:4]), rows)


@any_file
def test_golden_queries_cover_frames_times_between_and_both_ends(path: Path) -> None:
    own = golden(path)
    at = own.rows[:, 0] * own.medium.rate_hz
    is_frame = np.abs(at - np.round(at)) < 1e-9
    assert len(own.rows) == 100 and is_frame.sum() > 30 and (~is_frame).sum() > 30
    assert (at < 0).any() and (at > own.medium.frame_count - 1).any()
    is_felt = own.expected.force.any(axis=1)
    assert is_felt.sum() >= 40 and (~is_felt).sum() >= 5
    assert np.isfinite(own.rows).all()


def test_golden_vibrations_have_many_frequencies_and_ties() -> None:
    own = golden(CONFORMANCE / "queries" / "vibration.csv")
    amplitude, hertz = own.expected.vibration.T
    assert ((amplitude > 0) == (hertz > 0)).all()
    assert len(np.unique(hertz)) > 20
    medium, ties = own.medium, 0
    for time_s, *point_m in own.rows[amplitude > 0, :4].tolist():
        frame = round(np.clip(time_s * medium.rate_hz, 0, medium.frame_count - 1))
        corners, part = queries.Field(medium.vibration[frame], medium.head).cells(np.array([point_m]))
        weights = np.where(queries.CORNERS, part[0], 1 - part[0]).prod(axis=1)
        added = np.sort(weights * corners[:, 0, 0])
        ties += added[-1] > 0 and added[-1] - added[-2] < 1e-6 * added[-1]
    assert ties > 0, "points where the order of samples decides"


def test_clipped_bodies_are_clipped() -> None:
    own = golden(CONFORMANCE / "queries" / "bodies-clipped.csv")
    size = np.linalg.norm(own.expected.force, axis=1)
    assert (np.abs(size - 0.5) < 1e-8).sum() > 20 and ((size > 0) & (size < 0.49)).sum() > 20


@pytest.mark.parametrize(("column", "step"), [(5, 1e-5), (9, 1.0), (16, 1e-4), (17, 1.0)])
def test_a_wrong_answer_is_reported(column: int, step: float, tmp_path: Path) -> None:
    own = golden(CONFORMANCE / "queries" / "vibration.csv")
    wrong = own.rows.copy()
    wrong[60, column] += step
    other = queries.Queries(own.path, own.stated, wrong)
    assert own.agrees(own.expected) and not own.agrees(other.expected)
    wrong[60, column] = np.nan
    assert not own.agrees(other.expected)


# -- the package -------------------------------------------------------------------------------------------


@any_file
def test_the_package_computes_the_golden_queries(path: Path) -> None:
    own, sampler = golden(path), sampler_of(path)
    times, points = own.rows[:, 0], own.rows[:, 1:4]
    force, gradient = sampler.force_n(times, points), sampler.gradient_n_per_m(times, points)
    require(path, queries.Answers(force, gradient, np.stack(sampler.vibration(times, points), axis=1)))
    one = np.array([sampler.at(time_s, *point) for time_s, point in zip(times.tolist(), points.tolist())])
    together = np.stack([sampler.force_n(time_s, point[None])[0] for time_s, point in zip(times, points)])
    for found in (one, together):  # the quick ways to the force alone
        require(path, own.expected._replace(force=found))


@any_file
def test_one_vibration_of_the_module_is_that_of_many(path: Path) -> None:
    own, sampler = golden(path), sampler_of(path)
    found = []
    for time_s, *point in own.rows[:, :4].tolist():
        a, b, blend = sampler._instant(time_s)
        memory, first, second, *_ = sampler._pair(a, b)
        found.append(native.vibration_at(memory.bytes, first, second, blend, *point))
    require(path, own.expected._replace(vibration=np.array(found)))


# -- C -----------------------------------------------------------------------------------------------------


def write_groups(path: Path, to: Path) -> np.ndarray:
    """Write the memory of each pair of frames and its queries; returns the order of the rows."""
    own, sampler, order = golden(path), sampler_of(path), []
    instants = [sampler._instant(time_s) for time_s in own.rows[:, 0].tolist()]
    with to.open("wb") as out:
        for a, b in dict.fromkeys(instant[:2] for instant in instants):
            rows = [n for n, instant in enumerate(instants) if instant[:2] == (a, b)]
            memory, first, second, *_ = sampler._pair(a, b)
            out.write(np.array([memory.size_bytes, first, second, len(rows)], "<i8").tobytes())
            out.write(memory.bytes.tobytes())
            for n in rows:
                out.write(np.array([instants[n][2], *own.rows[n, 1:4]], "<f8").tobytes())
            order += rows
    return np.array(order)


C = CONFORMANCE.parent / "c"
BUILDS = {
    "sanitizers": ("-O1", "-g", *SANITIZERS),
    "fast": ("-O3",),
    "plain": ("-O0",),
    "without vectors": ("-O2", "-DWITHOUT_VECTORS"),
    "C11": ("-std=c11", "-O2"),
}


@needs_c
@pytest.mark.parametrize("build", BUILDS)
def test_c_computes_the_golden_queries(build: str, tmp_path: Path) -> None:
    program = built(tmp_path, "queries", f"-I{C}", *BUILDS[build], source=FOLDER / "queries.c")
    for path in FILES:
        order = write_groups(path, tmp_path / "in")
        assert run_with(program, tmp_path / "in", tmp_path / "out") == (0, "")
        require(path, answers_of(np.fromfile(tmp_path / "out").reshape(-1, 14)), order)


@pytest.fixture(scope="module")
def decoder_queries(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`query`, which decodes and answers by `touch.h` alone."""
    return built(tmp_path_factory.mktemp("c"), "query", "-O2", f"-I{C}", source=FOLDER / "query.c")


@needs_c
@any_stream
def test_the_small_decoder_computes_the_golden_queries_at_frames(
    path: Path, decoder_queries: Path, tmp_path: Path
) -> None:
    own = golden(path)
    at = np.clip(own.rows[:, 0] * own.medium.rate_hz, 0, own.medium.frame_count - 1)
    rows = np.flatnonzero(np.abs(at - np.round(at)) < 1e-9)
    own.rows[rows, 1:4].tofile(tmp_path / "points")
    assert run_with(decoder_queries, own.stream, tmp_path / "points", tmp_path / "out") == (0, "")
    found = np.fromfile(tmp_path / "out").reshape(own.medium.frame_count, len(rows), 14)
    require(path, answers_of(found[np.round(at[rows]).astype(int), np.arange(len(rows))]), rows)


# -- WebAssembly -------------------------------------------------------------------------------------------


def node(script: str, *files: Path) -> None:
    """Run a script of this folder."""
    command = [str(NODE), str(FOLDER / script), *map(str, files)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("is_page", [False, True])
def test_webassembly_computes_the_golden_queries(is_page: bool, tmp_path: Path) -> None:
    options = OF_THE_PAGE if is_page else ()
    module = wasm_module(tmp_path / "queries.wasm", *options, source="queries_wasm.c")
    for path in FILES:
        order = write_groups(path, tmp_path / "in")
        node("queries.mjs", module, tmp_path / "in", tmp_path / "out")
        found = answers_of(np.fromfile(tmp_path / "out").reshape(-1, 14))
        if is_page and path.stem == "deformed":  # the page has no deformation
            assert not golden(path).agrees(found, order)
        else:
            require(path, found, order)


@pytest.mark.skipif(NODE is None, reason="there is no node here")
@any_stream
def test_the_decoder_of_the_page_computes_the_golden_queries(path: Path, tmp_path: Path) -> None:
    packed = re.search(r'id="decoder">([^<]+)<', empty_page())
    assert packed is not None
    (tmp_path / "page.wasm").write_bytes(gzip.decompress(base64.b64decode(packed[1])))
    own = golden(path)
    asked = np.column_stack([own.rows[:, 0] * own.medium.rate_hz, own.rows[:, 1:4]])
    asked.astype("<f8").tofile(tmp_path / "in")
    node("queries_page.mjs", tmp_path / "page.wasm", own.stream, tmp_path / "in", tmp_path / "out")
    found = np.fromfile(tmp_path / "out").reshape(-1, 5)
    require(path, own.expected._replace(force=found[:, :3], vibration=found[:, 3:]))
