"""Makes a deformation that a stream carries: either the motion of an animated model, as moving control
points, or a compliance, by which a field yields to the hand (paper section 6.3)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.compute.threads import Progress, silent
from touchfield.errors import InvalidArgument, require_ending
from touchfield.medium.deformation import Deformation, fitted
from touchfield.network.opening import open_stream
from touchfield.pipeline.result import Result
from touchfield.pipeline.spec import Motion
from touchfield.sources.animation.animated_mesh import AnimatedMeshScene

_MARGIN: Final = 0.05  # margin of the lattice around the body, as a fraction of its longest side
_LAYER_SPACINGS: Final = 2.0  # depth of a second layer of points below the surface, in mean spacings


def control_lattice(low_m: Float64s, high_m: Float64s, controls: int, **yields: float) -> Deformation:
    """Return control points at rest over a box and a margin around it."""
    margin = _MARGIN * float((high_m - low_m).max())
    return Deformation.at_rest(low_m - margin, high_m + margin, controls, **yields)


def body_points_m(scene: AnimatedMeshScene, frame: int, depth_m: float) -> Float64s:
    """Return the vertices of a frame, and as many points below them, [n, 3].

    Those points are `depth_m` below the vertices along the normals.
    """
    vertices, triangles = scene.vertices_m(frame), scene.surface(frame).triangles
    a, b, c = (vertices[triangles[:, n]] for n in range(3))
    faces, normals = np.cross(b - a, c - a), np.zeros_like(vertices)
    for n in range(3):
        np.add.at(normals, triangles[:, n], faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    used = np.unique(triangles)
    return np.concatenate([vertices[used], (vertices - depth_m * normals)[used]])


def tracks_of(
    stream: str | Path,
    out: str | Path,
    motion: Motion | None = None,
    *,
    controls: int = 8,
    compliance_m_per_n: float = 0.0,
    relax_s: float = 0.05,
    report: Progress = silent,
) -> Result:
    """Write the deformation of a stream: the motion of its model, and its compliance.

    The stream shows the model at rest. A motion far from rest folds the lattice; divide a long motion into
    parts with a rest frame each. Without a motion, the lattice covers the samples of the first frame that
    have a force. InvalidArgument if neither a model nor a compliance is given, or the stream has objects;
    SourceError if the model has no animation.
    """
    require_ending(out, "DEFORMATION.npz")
    if motion is None and not compliance_m_per_n:
        hint = "Name MODEL.glb, or --yield-m-per-n."
        raise InvalidArgument("deform", "no model and no compliance", "one of both", hint)
    with open_stream(stream) as opened:
        if opened.scene is not None:
            hint = "Encode it with --representation voxel."
            raise InvalidArgument(str(stream), "a stream of objects", "one of voxels", hint)
        first, placement = opened.medium[0], opened.placement
    spacing = np.asarray(first.grid.spacing_m)
    if motion is None:
        positions_m = np.asarray(first.grid.origin_m) + first.positions() * spacing
        if not len(positions_m):
            raise InvalidArgument(str(stream), "a first frame without any force", "one with a force")
        yields = {"compliance_m_per_n": compliance_m_per_n, "relax_s": relax_s}
        deformation, rms = (
            control_lattice(positions_m.min(axis=0), positions_m.max(axis=0), controls, **yields),
            0.0,
        )
    else:
        scene = AnimatedMeshScene(Path(motion.model), motion.animation, rate_hz=motion.rate_hz)
        depth = _LAYER_SPACINGS * float(spacing.mean()) / opened.reader.head.mapping_scale

        def points(frame: int) -> Float64s:
            return np.asarray(placement.to_hand(body_points_m(scene, frame, depth)))

        first_frame, stop = motion.frames or (0, None)
        indices = range(scene.frame_count)[first_frame:stop]
        if not indices:
            raise InvalidArgument(
                "frames", f"{first_frame}:{stop}", f"some of the model's {scene.frame_count}"
            )
        sampled = np.concatenate(
            [points(indices[n]) for n in np.unique(np.linspace(0, len(indices) - 1, 16).astype(int))]
        )
        lattice = control_lattice(sampled.min(axis=0), sampled.max(axis=0), controls)
        rest = points(indices[0] if motion.rest_frame is None else motion.rest_frame)
        deformation, rms = fitted(
            rest, map(points, indices), lattice, motion.rate_hz, lambda done: report(done, len(indices))
        )
        deformation = replace(deformation, compliance_m_per_n=compliance_m_per_n, relax_s=relax_s)
    deformation.write(out)
    size = Path(out).stat().st_size
    figures = {
        "frames": len(deformation),
        "control_points": list(deformation.displacement_m.shape[1:4]),
        "rms_mm": 1e3 * rms,  # distance of the points of the body from their positions in the model
        "min_determinant": deformation.min_determinant()[0],
        "compliance_m_per_n": deformation.compliance_m_per_n,
        "file_bytes": size,
        "bytes_per_frame": size / len(deformation),
    }
    return Result({"file": str(out), **figures})
