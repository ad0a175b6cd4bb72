"""GPU kernels: at real size compiled for the CPU, and at small size on numba's simulator.

One item per thread must give the result of the CPU's loops; the simulator tests the transfers of arrays.
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

MAX_DIFFERENCE_N = 2e-6


@pytest.fixture
def gpu_kernels_on_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """GPU kernels run as compiled CPU code, with all items in one loop."""

    def for_each(kernel: Any, count: int, *arguments: Any) -> None:
        kernel(0, count, *arguments)

    def filled(kernel: Any, count: int, arguments: Any, shape: Any, dtype: Any) -> Any:
        out = np.full(shape, 7, dtype)  # marks items that a kernel does not write
        for_each(kernel, count, *arguments, out)
        return out

    for module in (depth, depth_scene):
        for name, stand_in in (
            ("uses_gpu", lambda: True),
            ("for_each", for_each),
            ("filled", filled),
            ("on_device", lambda x: x),
            ("on_host", lambda x: x),
        ):  # fmt: skip
            monkeypatch.setattr(module, name, stand_in, raising=module is depth)


def scene_of(name: str) -> Any:
    """A scene of real size, or a tiny one by its number."""
    if name == "motorcycle":
        return sample(name)
    return tiny_scenes()[int(name)]


@pytest.fixture
def cpu_result(request: pytest.FixtureRequest) -> tuple[Any, Grid, Any, Any]:
    """A scene, its lattice, its law, and its last frame from the CPU's loops; request it before
    `gpu_kernels_on_cpu`.
    """
    name, samples = request.param
    scene = scene_of(name)
    low, high = scene.bounds_m()
    margin_m = 0.1 * max(high - low)
    grid = Grid.over_box(low - margin_m, high + margin_m, (samples, samples - 3, samples + 2))
    law = penalty(LawSpec(), 3 * max(grid.spacing_m))
    return scene_of(name), grid, law, scene.field(scene.frame_count - 1, grid, law)


@pytest.mark.parametrize("cpu_result", [("motorcycle", 96), ("0", 40), ("2", 40)], indirect=True)
@pytest.mark.parametrize("bricks_per_launch", [1 << 26, 100])
def test_one_item_per_thread_agrees_with_the_loops(
    cpu_result: Any, bricks_per_launch: int, gpu_kernels_on_cpu: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Depth images, and views of a fused scene; also grids with more bricks than one launch takes."""
    monkeypatch.setattr(depth, "_GPU_BRICKS", bricks_per_launch)
    scene, grid, law, expected = cpu_result
    found = scene.field(scene.frame_count - 1, grid, law)
    assert len(expected.bricks) > 8
    assert np.array_equal(expected.bricks, found.bricks)
    assert np.abs(expected.forces_n - found.forces_n).max() <= MAX_DIFFERENCE_N


@pytest.fixture(scope="module")
def simulated() -> dict[str, dict[str, float]]:
    """The printed result of `simulated_gpu.py`."""
    tests_folder = Path(__file__).resolve().parents[1]
    run = subprocess.run(
        [sys.executable, "-W", "ignore", str(tests_folder / "simulated_gpu.py")],
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
    """Equal bricks, and forces within 2e-6 N."""
    result = simulated[name]
    assert result["force_n"] > 0.1
    assert result["difference_n"] <= MAX_DIFFERENCE_N
    assert result.get("same_bricks", True)


def test_invalid_or_missing_devices_are_refused() -> None:
    """An unknown device is refused, and so is a missing GPU."""
    with pytest.raises(InvalidArgument, match="one of cpu, cuda, auto"), gpu.computing("tpu"):
        pass
    with gpu.computing("auto"):
        has_gpu = gpu.uses_gpu()
    if has_gpu:
        pytest.skip("there is a GPU: nothing is refused")
    with pytest.raises((InvalidArgument, MissingExtra), match="GPU"), gpu.computing("cuda"):
        pass
    assert not gpu.uses_gpu()


def test_numpy_without_the_names_of_numba_cuda_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """numba-cuda fails at the first kernel; other faults of a kernel are not called that."""
    fault = ""

    def launch(*_: Any) -> None:
        raise AttributeError(fault)

    monkeypatch.setattr(gpu, "_launched", lambda kernel: {(1, gpu._THREADS): launch})
    fault = "module 'numpy' has no attribute 'row_stack'"
    with pytest.raises(InvalidArgument, match=r'row_stack.*pip install "numpy<2.5"'):
        gpu.for_each(None, 1)
    fault = "'Query' object has no attribute 'planes'"
    with pytest.raises(AttributeError, match="planes"):
        gpu.for_each(None, 1)


def test_source_without_gpu_kernels_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A requested GPU that a source does not use is an error, as any option without effect."""
    monkeypatch.setenv("TOUCHFIELD_COMPUTE", "cuda")
    assert any("--device-compute" in note for note in open_scene("sample:terrain", SourceOptions()).notes)
    assert not any(
        "--device-compute" in note for note in open_scene("sample:motorcycle", SourceOptions()).notes
    )


def test_device_is_restored_after_its_block(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nested blocks each restore the previous device."""
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


@pytest.mark.parametrize(("is_available", "expected"), [(True, "cuda auto"), (False, "cuda")])
def test_gpu_is_used_if_required_or_available(
    monkeypatch: pytest.MonkeyPatch, is_available: bool, expected: str
) -> None:
    monkeypatch.setattr(gpu, "_is_available", lambda: is_available)
    for device in gpu.COMPUTE:
        monkeypatch.setenv("TOUCHFIELD_COMPUTE", device)
        assert gpu.uses_gpu() == (device in expected.split())
