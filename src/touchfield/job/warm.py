"""Compiling every kernel before it is needed: those of the main job, of the haptic filters and of the measures."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from touchfield.codec.touch.spec import TouchSpec
from touchfield.filters.registry import field_filters
from touchfield.job.compare import compare
from touchfield.job.encode import encode
from touchfield.job.measure import MeasureSpec, measure_medium
from touchfield.job.play import PlaySpec, play
from touchfield.job.spec import EncodeSpec, Report, silent
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.render.sampler import FieldSampler

__all__ = ["GROUPS", "warm_up"]


def _solid() -> ForceField:
    """A solid with a wavy top that fills three bricks along each axis of its grid."""
    x, y, z = np.indices((24, 24, 24), np.float32)
    depth = 18 + np.sin(x / 3) + np.cos(y / 4) - z
    steep = np.stack([-np.cos(x / 3) / 3, np.sin(y / 4) / 4, np.ones_like(z)], axis=-1)
    grid = Grid((24, 24, 24), (0.01,) * 3, (0.0,) * 3)
    return ForceField.from_dense(grid, np.clip(0.2 * depth, 0, 2)[..., None] * steep)


def _passes() -> None:
    from touchfield.codec.touch.encoder import TouchEncoder

    TouchEncoder(_solid().grid, TouchSpec(guess="off")).encode_segment([_solid()] * 2)


def _columns() -> None:
    from touchfield.codec.touch.columns import synthesise
    from touchfield.codec.touch.columns_fit import fit
    from touchfield.codec.touch.promise import agreement
    from touchfield.codec.touch.rule import lattice_for, limits_for

    field, spec = _solid(), TouchSpec()
    lattice = lattice_for(spec, 2.0)
    found = fit(field, lattice, limits_for(spec, lattice))
    if found is not None:
        agreement(field, synthesise(found[0], field.grid), lattice.unit_n, spec)


def _filters() -> None:
    for kind in field_filters().values():
        kind.parse(kind.example)(_solid())


def _measures() -> None:
    medium = HapticMedium.from_frames([_solid()] * 2, 30.0)
    measure_medium(medium, MeasureSpec(devices=("tshirt-32x32",)))
    FieldSampler(medium).force_n(0.0, np.zeros((2, 3)))


GROUPS: Final[Mapping[str, Callable[[], None]]] = {
    "passes": _passes,
    "columns": _columns,
    "filters": _filters,
    "measures": _measures,
}
"""Kernels that are compiled together, each by a small job that calls them as the large ones do; the passes of the
coder `touch` and the columns of its guess are what a first `encode` takes longest to compile."""


def warm_up(report: Report = silent) -> None:
    """Compile and cache every kernel by running what there is on tiny scenes."""
    from touchfield.sources.samples import tiny_scenes

    scenes = tiny_scenes()
    jobs = [(scene, EncodeSpec(nw=3)) for scene in scenes]
    jobs += [(scenes[0], EncodeSpec(device="tshirt-32x32"))]
    jobs += [(scenes[-1], EncodeSpec(nw=3, representation="voxel", surface_damping_n_s_per_m=1.0))]
    jobs += [(scenes[1], EncodeSpec(nw=4, touch=asked)) for asked in (TouchSpec(), TouchSpec(mode="nmse"))]
    total = len(jobs) + len(GROUPS)
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "warm.touch"
        for i, (scene, spec) in enumerate(jobs):
            encode(scene, target, spec)
            compare(scene, target)
            report(i + 1, total)
        play(target, PlaySpec(offline=True, seconds=0.1))
    for i, group in enumerate(GROUPS.values()):
        group()
        report(len(jobs) + i + 1, total)
