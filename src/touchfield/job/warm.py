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
    with tempfile.TemporaryDirectory() as folder:
        for i, scene in enumerate(scenes):
            target = Path(folder) / "warm.touch"
            encode(scene, target, EncodeSpec(nw=3))
            compare(scene, target)
            report(i + 1, len(scenes))
