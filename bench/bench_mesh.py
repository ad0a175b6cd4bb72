"""Measures the time to compute signed distances in a band around a mesh, against five libraries.

    python bench/bench_mesh.py [--quick] [--samples N]

The mesh is a sphere with bumps, of 20,480 triangles, on 256^3 (or `--samples`^3) samples; the band is 4
voxels wide on each side. touchfield is timed from the triangles to the force field. Each installed peer
(Warp, Open3D, libigl, point-cloud-utils) is timed with the construction of its search tree, and evaluates
exactly the samples of the band, with sign; it does not have to find them. OpenVDB builds the band itself, in
a separate process (`openvdb_peer.py`; Debian's package python3-openvdb works, too). Distances and signs are
compared.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from functools import cache, partial
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machine import Bar, Figures, at_least, at_most, bench, column, timed
from touchfield.compute.threads import worker_count
from touchfield.medium import Grid
from touchfield.sources.laws import ForceProfile
from touchfield.sources.mesh.mesh_scene import MeshScene

Floats = NDArray[np.floating[Any]]
Peer = Callable[[Floats, NDArray[np.int32], Floats], Floats]
BAND = 4  # voxels on each side of the surface
RUNS = 3  # timed runs of a peer
APPROXIMATE = ("point-cloud-utils", "openvdb")
"""Peers whose distances are not exact.

At some samples of its band the signs of OpenVDB differ from all others.
"""
OPENVDB = str(Path(__file__).with_name("openvdb_peer.py"))
_BARE = {
    name: value for name, value in os.environ.items() if not name.startswith("PYTHON")
}  # environment for another interpreter


def bumpy(subdivisions: int = 5) -> tuple[Floats, NDArray[np.int32]]:
    """Return a sphere with bumps, of 20 * 4^subdivisions triangles, within [-1, 1]^3."""
    trimesh = import_module("trimesh")
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    x, y, z = np.asarray(mesh.vertices).T
    radius = (
        1 + 0.15 * np.sin(6 * x) * np.sin(5 * y) * np.sin(7 * z) + 0.05 * np.sin(20 * x + 3) * np.cos(17 * y)
    )
    return np.asarray(mesh.vertices) * 0.8 * radius[:, None], np.asarray(mesh.faces, np.int32)


def igl(vertices: Floats, faces: NDArray[np.int32], points: Floats) -> Floats:
    """Compute distances by libigl: axis-aligned box tree, sign by the pseudo-normal.

    With the fast winding number, its distances are wrong.
    """
    library = import_module("igl")
    kind = library.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
    result = library.signed_distance(points.astype(np.float64), vertices, faces.astype(np.int64), kind)
    return np.asarray(result[0]).reshape(-1)


def point_cloud_utils(vertices: Floats, faces: NDArray[np.int32], points: Floats) -> Floats:
    """Compute distances by point-cloud-utils: Embree, sign by the fast winding number."""
    library = import_module("point_cloud_utils")
    return np.asarray(library.signed_distance_to_mesh(points.astype(np.float64), vertices, faces)[0])


def open3d(vertices: Floats, faces: NDArray[np.int32], points: Floats) -> Floats:
    """Compute distances by Open3D: Embree, sign by the parity of a ray."""
    library = import_module("open3d")
    scene = library.t.geometry.RaycastingScene()
    scene.add_triangles(
        library.core.Tensor(vertices.astype(np.float32)), library.core.Tensor(faces.astype(np.uint32))
    )
    return np.asarray(scene.compute_signed_distance(library.core.Tensor(points.astype(np.float32))).numpy())


def warp(vertices: Floats, faces: NDArray[np.int32], points: Floats, winds: bool = False) -> Floats:
    """Compute distances by Warp on the CPU, with a box tree.

    The sign is that of the normal at the nearest point or, with `winds`, of the winding number.
    """
    library = import_module("warp")
    mesh = library.Mesh(
        points=library.array(vertices.astype(np.float32), dtype=library.vec3, device="cpu"),
        indices=library.array(faces.reshape(-1), dtype=library.int32, device="cpu"),
        support_winding_number=winds,
    )
    queries = library.array(points.astype(np.float32), dtype=library.vec3, device="cpu")
    out = library.zeros(len(points), dtype=library.float32, device="cpu")
    library.launch(
        _warp_kernel(library, winds), dim=len(points), inputs=[mesh.id, queries, out], device="cpu"
    )
    return np.asarray(out.numpy())


@cache
def _warp_kernel(library: Any, winds: bool) -> Any:
    def by_normal(mesh, queries, out):  # type: ignore[no-untyped-def]
        i = library.tid()
        query = library.mesh_query_point_sign_normal(mesh, queries[i], 1.0e6)
        nearest = library.mesh_eval_position(mesh, query.face, query.u, query.v)
        out[i] = query.sign * library.length(queries[i] - nearest)

    def by_winding(mesh, queries, out):  # type: ignore[no-untyped-def]
        i = library.tid()
        query = library.mesh_query_point_sign_winding_number(mesh, queries[i], 1.0e6)
        nearest = library.mesh_eval_position(mesh, query.face, query.u, query.v)
        out[i] = query.sign * library.length(queries[i] - nearest)

    signed_distance = by_winding if winds else by_normal
    signed_distance.__annotations__ = {
        "mesh": library.uint64,
        "queries": library.array(dtype=library.vec3),
        "out": library.array(dtype=library.float32),
    }
    return library.kernel(signed_distance)


@cache
def openvdb_python() -> tuple[str, str] | None:
    """Return an interpreter that has OpenVDB, and the version; None if there is none.

    This interpreter is tried first, then the system's.
    """
    for interpreter in (sys.executable, "/usr/bin/python3"):
        try:
            found = subprocess.run(
                [interpreter, OPENVDB], env=_BARE, check=True, capture_output=True, text=True
            )
        except (OSError, subprocess.CalledProcessError):
            continue
        return interpreter, found.stdout.strip()
    return None


def openvdb(
    vertices: Floats, faces: NDArray[np.int32], points: Floats, runs: int
) -> tuple[Floats, dict[str, float]]:
    """Run OpenVDB in a separate process; return signed distances and milliseconds.

    The milliseconds are those of the runs, without the start of the process.
    """
    found = openvdb_python()
    assert found is not None
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "mesh.npz", Path(folder) / "values.npz"
        np.savez(source, vertices=vertices, faces=faces, points=points, band=BAND + 1)
        subprocess.run([found[0], OPENVDB, source, target, str(runs)], env=_BARE, check=True)
        result = np.load(target)
        milliseconds = 1e3 * np.sort(result["seconds"])
    return result["values"], {"min_ms": float(milliseconds[0]), "median_ms": float(milliseconds[runs // 2])}


PEERS: dict[str, tuple[str, Peer]] = {
    "libigl": ("igl", igl),
    "point-cloud-utils": ("point_cloud_utils", point_cloud_utils),
    "open3d": ("open3d", open3d),
    "warp-lang": ("warp", warp),
    "warp-lang, sign by winding": ("warp", partial(warp, winds=True)),
}


def missing(names: Iterable[str]) -> list[str]:
    """Return the names of the peers that cannot be imported."""
    absent = []
    for name in names:
        try:
            import_module(PEERS[name][0])
        except (ImportError, OSError):
            absent.append(name)
    return absent


def differences(values: Floats, phi: Floats, voxel: float) -> dict[str, float]:
    """Return how far a peer's signed distances are from touchfield's."""
    is_wrong = (values > 0) != (phi > 0)
    return {
        "largest_difference_voxels": float(np.abs(np.abs(values) - np.abs(phi)).max() / voxel),
        "signs_that_differ": int(is_wrong.sum()),
        "farthest_of_them_voxels": float(np.abs(phi[is_wrong]).max(initial=0) / voxel),
    }


def measure(samples: int) -> Figures:
    """Measure times and differences of touchfield and the peers on one mesh."""
    vertices, faces = bumpy()
    grid = Grid.over_box((-1,) * 3, (1,) * 3, (samples,) * 3)
    voxel = grid.spacing_m[0]
    # |F| = 2 + phi / (BAND * voxel), so the field gives phi back
    law = ForceProfile(((-BAND * voxel, BAND * voxel, 2.0, 1 / (BAND * voxel)),))

    field = MeshScene(vertices, faces).field(0, grid, law)
    points = grid.to_m(field.positions())
    phi = (np.linalg.norm(field.vectors_n().astype(np.float64), axis=1) - 2) * BAND * voxel
    scene = MeshScene(vertices, faces)
    rows: dict[str, dict[str, Any]] = {
        "touchfield": timed(lambda: MeshScene(vertices, faces).field(0, grid, law), runs=15),
        "touchfield, same mesh again": timed(lambda: scene.field(0, grid, law), runs=15, warm=2),
    }
    absent = missing(PEERS)
    for name, (_, peer) in PEERS.items():
        if name in absent:
            continue
        values = peer(vertices, faces, points)
        times = timed(partial(peer, vertices, faces, points), RUNS, warm=0)
        rows[name] = {
            **times,
            "version": metadata.version(name.split(",")[0]),
            **differences(values, phi, voxel),
        }
    found = openvdb_python()
    if found:
        values, times = openvdb(vertices, faces, points, RUNS)
        rows["openvdb"] = {**times, "version": found[1], **differences(values, phi, voxel)}
    else:
        absent.append("openvdb")
    for row in rows.values():
        row["times_touchfield"] = row["min_ms"] / rows["touchfield"]["min_ms"]
    counts = {
        "samples": samples,
        "triangles": len(faces),
        "band_samples": len(points),
        "threads": worker_count(),
    }
    return {**counts, "rows": rows, "absent": absent}


def bars(figures: Figures) -> list[Bar]:
    """Require twice the speed of the fastest peer, and equal signed distances."""
    peers = {name: row for name, row in figures["rows"].items() if "version" in row}
    fastest = min(column(peers, "times_touchfield"), default=None)
    exact = {name: row for name, row in peers.items() if name not in APPROXIMATE}
    signed = {name: row for name, row in peers.items() if name != "openvdb"}
    return [
        at_least("time of the fastest peer over ours", fastest, 2.0),
        at_most(
            "largest difference of a distance to an exact peer's",
            max(column(exact, "largest_difference_voxels"), default=None),
            1e-2,
            "voxels",
        ),
        at_most("signs that differ from a peer's", max(column(signed, "signs_that_differ"), default=None), 0),
    ]


if __name__ == "__main__":
    bench("mesh", __doc__, measure, bars, samples=(256, 64))
