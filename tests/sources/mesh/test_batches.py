"""Fields of meshes by batches of bricks: the forces of one batch, in the memory of the result."""

from __future__ import annotations

import tracemalloc

import pytest

from mesh_makers import cube
from touchfield.medium import ForceField, Grid
from touchfield.sources.laws import ForceProfile
from touchfield.sources.mesh.kernels import field as kernels
from touchfield.sources.mesh.mesh_scene import MeshScene

GRID = Grid((96, 96, 96), (0.02, 0.02, 0.02), (-0.5, -0.5, -0.5))
LAW = ForceProfile(((-0.1, 0.0, 1.0, -10.0),), surface_damping_n_s_per_m=0.5)


def scene(face_count: int) -> MeshScene:
    """A moving cube without some of its faces."""
    vertices, faces = cube()
    found = MeshScene(vertices, faces[:face_count], holes="leave")
    found.velocities_m_s = vertices[:, [1, 2, 0]] + 1.0
    return found


def field(face_count: int) -> ForceField:
    return scene(face_count).field(0, GRID, LAW)


@pytest.mark.parametrize("face_count", [12, 10, 2], ids=["closed", "open", "sheet"])
def test_batches_do_not_change_a_field(face_count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = field(face_count)
    monkeypatch.setattr(kernels, "BATCH_BRICKS", 7)
    assert len(whole.bricks) > 14
    assert field(face_count) == whole


def test_the_memory_is_that_of_the_bricks_with_a_force(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels, "BATCH_BRICKS", 16)
    sheet, candidates = scene(2), list[int]()
    find_bricks = kernels._find_bricks

    def counted(*arguments: object) -> object:
        found = find_bricks(*arguments)
        candidates.append(len(found[0]))
        return found

    monkeypatch.setattr(kernels, "_find_bricks", counted)
    sheet.field(0, GRID, LAW)  # surface tables, cached
    tracemalloc.start()
    try:
        result = sheet.field(0, GRID, LAW)
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert candidates[0] * 6144 > 1.5 * result.forces_n.nbytes
    assert peak_bytes < 1.5 * result.forces_n.nbytes + 16 * 8192 + (1 << 18)
