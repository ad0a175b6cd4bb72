"""Kernels of a GPU: at real size compiled for the processor, and at small sizes on numba's simulator.

One item a thread must give what the loops of the processor give; the simulator shows that arrays go there and
back.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import touchfield.compute.cuda as gpu
from touchfield.errors import InvalidArgument, MissingExtra
from touchfield.medium import Grid
from touchfield.pipeline.source import open_scene
from touchfield.sources.depth import depth_scene
from touchfield.sources.depth.kernels import field as depth
from touchfield.sources.laws import LawSpec, penalty
from touchfield.sources.options import SourceOptions
from touchfield.sources.samples import sample
from touchfield.sources.tiny_scenes import tiny_scenes

MOST_N = 2e-6


@pytest.fixture
def as_if(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels of the GPU run in compiled code of the processor, all items in one loop."""

    def for_each(kernel: Any, count: int, *arguments: Any) -> None:
        kernel(0, count, *arguments)

    def filled(kernel: Any, count: int, arguments: Any, shape: Any, dtype: Any) -> Any:
        out = np.full(shape, 7, dtype)  # what a kernel leaves out is seen
        for_each(kernel, count, *arguments, out)
        return out

    for room in (depth, depth_scene):
        for name, stand_in in (
            ("uses_gpu", lambda: True),
            ("for_each", for_each),
            ("filled", filled),
            ("on_device", lambda x: x),
            ("on_host", lambda x: x),
        ):  # fmt: skip
            monkeypatch.setattr(room, name, stand_in, raising=room is depth)


def scene_of(name: str) -> Any:
    """A scene of real size, or a tiny one by its number."""
    if name == "motorcycle":
        return sample(name)
    return tiny_scenes()[int(name)]


@pytest.fixture
def processors(request: pytest.FixtureRequest) -> tuple[Any, Grid, Any, Any]:
    """A scene, its lattice, its law, and its last frame by the processor's own loops; asked for before
    `as_if`.
    """
    name, samples = request.param
    scene = scene_of(name)
    low, high = scene.bounds_m()
    room = 0.1 * max(high - low)
    grid = Grid.over_box(low - room, high + room, (samples, samples - 3, samples + 2))
    law = penalty(LawSpec(), 3 * max(grid.spacing_m))
    return scene_of(name), grid, law, scene.field(scene.frame_count - 1, grid, law)


@pytest.mark.parametrize("processors", [("motorcycle", 96), ("0", 40), ("2", 40)], indirect=True)
@pytest.mark.parametrize("at_once", [1 << 26, 100])
def test_one_item_a_thread_is_what_the_loops_give(
    processors: Any, at_once: int, as_if: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Depth, and views of a fused world; also where a grid has more bricks than are looked at at once."""
    monkeypatch.setattr(depth, "_GPU_BRICKS", at_once)
    scene, grid, law, own = processors
    other = scene.field(scene.frame_count - 1, grid, law)
    assert len(own.bricks) > 8
    assert np.array_equal(own.bricks, other.bricks)
    assert np.abs(own.forces_n - other.forces_n).max() <= MOST_N


@pytest.fixture(scope="module")
def simulated() -> dict[str, dict[str, float]]:
    """What `simulated_gpu.py` prints."""
    here = Path(__file__).resolve().parents[1]
    run = subprocess.run(
        [sys.executable, "-W", "ignore", str(here / "simulated_gpu.py")],
        env={**os.environ, "NUMBA_ENABLE_CUDASIM": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    out: dict[str, dict[str, float]] = json.loads(run.stdout)
    return out


@pytest.mark.parametrize("name", ["DepthScene 0", "FusedScene 2", "voxels", "objects"])
def test_simulator(simulated: dict[str, dict[str, float]], name: str) -> None:
    """The same bricks, and forces within 2e-6 N."""
    told = simulated[name]
    assert told["force_n"] > 0.1
    assert told["difference_n"] <= MOST_N
    assert told.get("same_bricks", True)


def test_words() -> None:
    """What is no place is refused, and so is a GPU that is not there."""
    with pytest.raises(InvalidArgument, match="one of cpu, cuda, auto"), gpu.computing("tpu"):
        pass
    with gpu.computing("auto"):
        has_gpu = gpu.uses_gpu()
    if has_gpu:
        pytest.skip("there is a GPU: nothing is refused")
    with pytest.raises((InvalidArgument, MissingExtra), match="GPU"), gpu.computing("cuda"):
        pass
    assert not gpu.uses_gpu()


def test_a_source_that_has_none_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a GPU is asked for, as where another option of the command does nothing."""
    monkeypatch.setenv("TOUCHFIELD_COMPUTE", "cuda")
    assert any("--device-compute" in note for note in open_scene("sample:terrain", SourceOptions()).notes)
    assert not any(
        "--device-compute" in note for note in open_scene("sample:motorcycle", SourceOptions()).notes
    )


def test_the_place_ends_with_its_block(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of blocks within blocks, each ends with what was before it."""
    monkeypatch.setenv("TOUCHFIELD_COMPUTE", "cpu")
    with gpu.computing("auto"):
        with gpu.computing("cpu"):
            assert os.environ["TOUCHFIELD_COMPUTE"] == "cpu"
        assert os.environ["TOUCHFIELD_COMPUTE"] == "auto"
    assert os.environ["TOUCHFIELD_COMPUTE"] == "cpu"
    monkeypatch.delenv("TOUCHFIELD_COMPUTE")
    with gpu.computing("cpu"):
        pass
    assert "TOUCHFIELD_COMPUTE" not in os.environ


@pytest.mark.parametrize(("is_there", "expected"), [(True, "cuda auto"), (False, "cuda")])
def test_a_gpu_is_used_where_it_must_be_or_where_there_is_one(
    monkeypatch: pytest.MonkeyPatch, is_there: bool, expected: str
) -> None:
    monkeypatch.setattr(gpu, "_is_available", lambda: is_there)
    for where in gpu.COMPUTE:
        monkeypatch.setenv("TOUCHFIELD_COMPUTE", where)
        assert gpu.uses_gpu() == (where in expected.split())
