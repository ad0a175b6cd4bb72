"""A deformation for a stream: tracks of a model that it shows at rest, or a lattice that yields (paper 6.3)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.compute.threads import Report, silent
from touchfield.errors import InvalidArgument, require_ending
from touchfield.medium.deformation import Deformation, fitted
from touchfield.pipeline.decoding import open_stream
from touchfield.pipeline.result import Result
from touchfield.pipeline.spec import Motion
from touchfield.sources.animation.animated_mesh import AnimatedMeshScene

_MARGIN: Final = 0.05  # of the lattice beyond what it bends, of its longest side
_BEHIND: Final = 2.0  # mean spacings below the surface, where a second layer of points is held


def lattice_of(low_m: Float64s, high_m: Float64s, controls: int, **yields: float) -> Deformation:
    """Control points over a box and a margin around it, at rest."""
    margin = _MARGIN * float((high_m - low_m).max())
    return Deformation.at_rest(low_m - margin, high_m + margin, controls, **yields)


def body_points_m(scene: AnimatedMeshScene, frame: int, behind_m: float) -> Float64s:
    """Vertices of a frame, and as many so far behind them, along the normals: what moves with the skin, [n,
    3].
    """
    vertices, triangles = scene.vertices_m(frame), scene.surface(frame).triangles
    a, b, c = (vertices[triangles[:, n]] for n in range(3))
    faces, normals = np.cross(b - a, c - a), np.zeros_like(vertices)
    for n in range(3):
        np.add.at(normals, triangles[:, n], faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    used = np.unique(triangles)
    return np.concatenate([vertices[used], (vertices - behind_m * normals)[used]])


def tracks_of(
    stream: str | Path,
    out: str | Path,
    motion: Motion | None = None,
    *,
    controls: int = 8,
    compliance_m_per_n: float = 0.0,
    relax_s: float = 0.05,
    report: Report = silent,
) -> Result:
    """Write the deformation of a stream: the motion of a model, which it shows at rest, and what it yields.

    What moves far from rest folds: a long motion is stretches, each with a rest of its own. Without a motion
    the lattice lies over what holds a force in the first frame. InvalidArgument if neither a model nor a
    compliance is given, or the stream holds objects; SourceError if the model has no animation.
    """
    require_ending(out, "DEFORMATION.npz")
    if motion is None and not compliance_m_per_n:
        mend = "Name MODEL.glb, or --yield-m-per-n."
        raise InvalidArgument("deform", "no model and no compliance", "one of both", mend)
    with open_stream(stream) as opened:
        if opened.scene is not None:
            mend = "Encode it with --representation voxel."
            raise InvalidArgument(str(stream), "a stream of objects", "one of voxels", mend)
        first, placement = opened.medium[0], opened.placement
    spacing = np.asarray(first.grid.spacing_m)
    if motion is None:
        at = np.asarray(first.grid.origin_m) + first.positions() * spacing
        if not len(at):
            raise InvalidArgument(str(stream), "a first frame without any force", "one that can be felt")
        yields = {"compliance_m_per_n": compliance_m_per_n, "relax_s": relax_s}
        bend, rms = lattice_of(at.min(axis=0), at.max(axis=0), controls, **yields), 0.0
    else:
        scene = AnimatedMeshScene(Path(motion.model), motion.animation, rate_hz=motion.rate_hz)
        behind = _BEHIND * float(spacing.mean()) / opened.reader.head.mapping_scale

        def points(frame: int) -> Float64s:
            return np.asarray(placement.to_hand(body_points_m(scene, frame, behind)))

        first_frame, stop = motion.frames or (0, None)
        taken = range(scene.frame_count)[first_frame:stop]
        if not taken:
            raise InvalidArgument(
                "frames", f"{first_frame}:{stop}", f"some of the model's {scene.frame_count}"
            )
        looks = np.concatenate(
            [points(taken[n]) for n in np.unique(np.linspace(0, len(taken) - 1, 16).astype(int))]
        )
        lattice = lattice_of(looks.min(axis=0), looks.max(axis=0), controls)
        rest = points(taken[0] if motion.rest_frame is None else motion.rest_frame)
        bend, rms = fitted(
            rest, map(points, taken), lattice, motion.rate_hz, lambda done: report(done, len(taken))
        )
        bend = replace(bend, compliance_m_per_n=compliance_m_per_n, relax_s=relax_s)
    bend.write(out)
    size = Path(out).stat().st_size
    figures = {
        "frames": len(bend),
        "control_points": list(bend.displacement_m.shape[1:4]),
        "rms_mm": 1e3 * rms,  # distance of the points of the surface from where the model has them
        "least_determinant": bend.least_determinant()[0],
        "compliance_m_per_n": bend.compliance_m_per_n,
        "file_bytes": size,
        "bytes_per_frame": size / len(bend),
    }
    return Result({"file": str(out), **figures})
