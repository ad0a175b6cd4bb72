"""A mesh to its signed band: 20,480 triangles, 256^3 samples, every sample within 4 voxels of the surface.

    python bench/bench_mesh.py [samples]

Ours is timed from the triangles to the force field. Each peer that imports here (Warp, Open3D, libigl,
point-cloud-utils) is timed with the making of its search tree, and is asked for exactly the samples of the band, with
sign; none of them has to find out which those are. OpenVDB makes the band itself. Distances and signs are compared.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache, partial
from importlib import import_module, metadata
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machine import keep, timed
from touchfield.medium import Grid
from touchfield.parallel import worker_count
from touchfield.sources.mesh_scene import MeshScene
from touchfield.sources.profile import ForceProfile

Floats = NDArray[np.floating[Any]]
Peer = Callable[[Floats, NDArray[np.int32], Floats], Floats]
BAND = 4  # voxels
BAR = 2.0


def bumpy(subdivisions: int = 5) -> tuple[Floats, NDArray[np.int32]]:
    """A sphere with bumps, 20 * 4^subdivisions triangles, within the cube from -1 to 1."""
    trimesh = import_module("trimesh")
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    x, y, z = np.asarray(mesh.vertices).T
    radius = 1 + 0.15 * np.sin(6 * x) * np.sin(5 * y) * np.sin(7 * z) + 0.05 * np.sin(20 * x + 3) * np.cos(17 * y)
    return np.asarray(mesh.vertices) * 0.8 * radius[:, None], np.asarray(mesh.faces, np.int32)


def igl(vertices: Floats, faces: NDArray[np.int32], points: Floats) -> Floats:
    """libigl: axis-aligned box tree, sign by the pseudo-normal (with the fast winding number, distances are off)."""
    library = import_module("igl")
    kind = library.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
    result = library.signed_distance(points.astype(np.float64), vertices, faces.astype(np.int64), kind)
    return np.asarray(result[0]).reshape(-1)


def point_cloud_utils(vertices: Floats, faces: NDArray[np.int32], points: Floats) -> Floats:
    """point-cloud-utils: Embree, sign by the fast winding number."""
    library = import_module("point_cloud_utils")
    return np.asarray(library.signed_distance_to_mesh(points.astype(np.float64), vertices, faces)[0])


def open3d(vertices: Floats, faces: NDArray[np.int32], points: Floats) -> Floats:
    """Open3D: Embree, sign by the parity of a ray."""
    library = import_module("open3d")
    scene = library.t.geometry.RaycastingScene()
    scene.add_triangles(
        library.core.Tensor(vertices.astype(np.float32)), library.core.Tensor(faces.astype(np.uint32))
    )
    return np.asarray(scene.compute_signed_distance(library.core.Tensor(points.astype(np.float32))).numpy())


def warp(vertices: Floats, faces: NDArray[np.int32], points: Floats, winds: bool = False) -> Floats:
    """Warp on the processor: box tree, sign by the normal of the nearest place, or by the winding number."""
    library = import_module("warp")
    mesh = library.Mesh(
        points=library.array(vertices.astype(np.float32), dtype=library.vec3, device="cpu"),
        indices=library.array(faces.reshape(-1), dtype=library.int32, device="cpu"),
        support_winding_number=winds,
    )
    places = library.array(points.astype(np.float32), dtype=library.vec3, device="cpu")
    out = library.zeros(len(points), dtype=library.float32, device="cpu")
    library.launch(_warp_kernel(library, winds), dim=len(points), inputs=[mesh.id, places, out], device="cpu")
    return np.asarray(out.numpy())


@cache
def _warp_kernel(library: Any, winds: bool) -> Any:
    def by_normal(mesh, places, out):  # type: ignore[no-untyped-def]
        i = library.tid()
        query = library.mesh_query_point_sign_normal(mesh, places[i], 1.0e6)
        nearest = library.mesh_eval_position(mesh, query.face, query.u, query.v)
        out[i] = query.sign * library.length(places[i] - nearest)

    def by_winding(mesh, places, out):  # type: ignore[no-untyped-def]
        i = library.tid()
        query = library.mesh_query_point_sign_winding_number(mesh, places[i], 1.0e6)
        nearest = library.mesh_eval_position(mesh, query.face, query.u, query.v)
        out[i] = query.sign * library.length(places[i] - nearest)

    signed_distance = by_winding if winds else by_normal
    signed_distance.__annotations__ = {
        "mesh": library.uint64,
        "places": library.array(dtype=library.vec3),
        "out": library.array(dtype=library.float32),
    }
    return library.kernel(signed_distance)


def openvdb(vertices: Floats, faces: NDArray[np.int32], points: Floats) -> Floats:
    """OpenVDB: its own narrow band, then the values of our samples."""
    library = import_module("openvdb")
    voxel = float(np.diff(np.unique(points[:, 2])[:2])[0])
    transform = library.createLinearTransform(voxelSize=voxel)
    low = points.min(axis=0)
    grid = library.FloatGrid.createLevelSetFromPolygons(
        vertices - low, triangles=faces, transform=transform, halfWidth=float(BAND + 1)
    )
    index = np.round((points - low) / voxel).astype(int)
    dense = np.empty(tuple(index.max(axis=0) + 1), np.float32)
    grid.copyToArray(dense)
    return np.asarray(dense[tuple(index.T)])


PEERS: dict[str, tuple[str, Peer]] = {
    "libigl": ("igl", igl),
    "point-cloud-utils": ("point_cloud_utils", point_cloud_utils),
    "open3d": ("open3d", open3d),
    "warp-lang": ("warp", warp),
    "warp-lang, sign by winding": ("warp", partial(warp, winds=True)),
    "openvdb": ("openvdb", openvdb),
}


def main() -> None:
    """Print the table and keep the figures."""
    samples = int(sys.argv[1]) if len(sys.argv) > 1 else 256
    vertices, faces = bumpy()
    grid = Grid.over_box((-1,) * 3, (1,) * 3, (samples,) * 3)
    voxel = grid.spacing_m[0]
    law = ForceProfile(((-BAND * voxel, BAND * voxel, 2.0, 1 / (BAND * voxel)),))  # |F| tells phi

    field = MeshScene(vertices, faces).field(0, grid, law)
    points = grid.to_m(field.positions())
    phi = (np.linalg.norm(field.vectors_n().astype(np.float64), axis=1) - 2) * BAND * voxel
    scene = MeshScene(vertices, faces)
    rows: dict[str, dict[str, Any]] = {
        "touchfield": timed(lambda: MeshScene(vertices, faces).field(0, grid, law), runs=15),
        "touchfield, same mesh again": timed(lambda: scene.field(0, grid, law), runs=15, warm=2),
    }
    absent = []
    for name, (module, peer) in PEERS.items():
        try:
            import_module(module)
        except (ImportError, OSError):
            absent.append(name)
            continue
        values = peer(vertices, faces, points)
        wrong = (values > 0) != (phi > 0)
        rows[name] = {
            **timed(lambda p=peer: p(vertices, faces, points), runs=3, warm=0),
            "version": metadata.version(name.split(",")[0]),
            "largest_difference_voxels": float(np.abs(np.abs(values) - np.abs(phi)).max() / voxel),
            "signs_that_differ": int(wrong.sum()),
            "farthest_of_them_voxels": float(np.abs(phi[wrong]).max(initial=0) / voxel),
        }
    for row in rows.values():
        row["times_touchfield"] = row["min_ms"] / rows["touchfield"]["min_ms"]
    print(f"{len(faces)} triangles, {samples}^3, {len(points)} samples in the band, {worker_count()} threads")
    for name, row in rows.items():
        line = f"  {name:28} {row['min_ms']:9.1f} ms {row['times_touchfield']:7.2f}x"
        if "version" in row:
            line += f"   differs by {row['largest_difference_voxels']:.2g} voxels, {row['signs_that_differ']} signs"
        print(line)
    print(f"  absent: {', '.join(absent) or 'none'}")
    fastest = min(row["times_touchfield"] for row in rows.values() if "version" in row)
    verdict = {"bar": "times that the fastest peer takes", "limit": BAR, "measured": fastest, "met": fastest >= BAR}
    print(
        f"  the fastest peer takes {fastest:.2f} times as long; bar {BAR:g}: {'met' if verdict['met'] else 'NOT MET'}"
    )
    figures = {"samples": samples, "band_samples": len(points), "rows": rows, "absent": absent}
    keep("mesh", {**figures, "bars": [verdict]})


if __name__ == "__main__":
    main()
