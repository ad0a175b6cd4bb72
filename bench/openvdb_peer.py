"""Computes signed distances by OpenVDB for `bench_mesh`, in a separate process.

    PYTHON bench/openvdb_peer.py INPUT.npz OUTPUT.npz RUNS

The program needs only NumPy, because Debian's OpenVDB is built for Debian's Python and NumPy and crashes with
another NumPy. The module is called `openvdb` or `pyopenvdb`. Without arguments the program prints the
version, and fails if the module is missing.
"""

from __future__ import annotations

import sys
from importlib import import_module
from time import perf_counter
from typing import Any

import numpy as np


def library() -> Any:
    """Import the module under either of its names; ImportError if there is none."""
    try:
        return import_module("openvdb")
    except ImportError:
        return import_module("pyopenvdb")


def version() -> str:
    """Return the version, such as 10.0.1."""
    return ".".join(map(str, library().LIBRARY_VERSION))


def distances(vertices: Any, faces: Any, points: Any, band: float) -> Any:
    """Return signed distances of lattice `points`, from a band of `band` voxels."""
    vdb = library()
    voxel = float(np.diff(np.unique(points[:, 2])[:2])[0])
    transform = vdb.createLinearTransform(voxelSize=voxel)
    low = points.min(axis=0)
    grid = vdb.FloatGrid.createLevelSetFromPolygons(
        vertices - low, triangles=faces, transform=transform, halfWidth=float(band)
    )
    index = np.round((points - low) / voxel).astype(int)
    dense = np.empty(tuple(index.max(axis=0) + 1), np.float32)
    grid.copyToArray(dense)
    return dense[tuple(index.T)]


def main(source: str, target: str, runs: str) -> None:
    """Write the values, and the seconds of each run."""
    inputs = np.load(source)
    vertices, faces, points, band = (inputs[name] for name in ("vertices", "faces", "points", "band"))
    seconds = []
    for _ in range(int(runs)):
        began = perf_counter()
        values = distances(vertices, faces, points, float(band))
        seconds.append(perf_counter() - began)
    np.savez(target, values=values, seconds=seconds)


if __name__ == "__main__":
    main(*sys.argv[1:]) if len(sys.argv) > 1 else print(version())
