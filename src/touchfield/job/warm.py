"""Compiling every kernel of the main job before it is needed."""

from __future__ import annotations

import tempfile
from pathlib import Path

from touchfield.job.compare import compare
from touchfield.job.encode import encode
from touchfield.job.spec import EncodeSpec, Report, silent

__all__ = ["warm_up"]


def warm_up(report: Report = silent) -> None:
    """Compile and cache every kernel of the main job by running it on tiny scenes."""
    from touchfield.sources.samples import tiny_scenes

    scenes = tiny_scenes()
    specs = [EncodeSpec(nw=3), EncodeSpec(device="tshirt-32x32")]
    jobs = [(scene, specs[0]) for scene in scenes] + [(scenes[0], specs[1])]
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "warm.touch"
        for i, (scene, spec) in enumerate(jobs):
            encode(scene, target, spec)
            compare(scene, target)
            report(i + 1, len(jobs))
