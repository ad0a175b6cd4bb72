"""Rigid-body models in MuJoCo's own format (MJCF ``.xml``), simulated: each body a scene with its pose track.

Format: an XML file whose root element is ``mujoco``; it may include other files and name mesh files, which lie in
its folder or below it unless the user allows others (`touchfield.sources.mjcf_files`). The library
`mujoco` reads and steps it (extra "physics"). The duration is what is asked for, else
``<custom><numeric name="touchfield_seconds" data="..."/></custom>``, else 2 s. The simulation begins from the
keyframe of the name "touchfield", else from the model's own initial state. Lengths are metres.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

from touchfield.errors import SourceError
from touchfield.sources.body_scene import BodyScene
from touchfield.sources.mjcf_files import check_files
from touchfield.sources.mujoco_bodies import pieces_of
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import Body
from touchfield.sources.simulation import (
    FRAME_RATE_HZ,
    frames_of,
    load_mujoco,
    mujoco_faults,
    simulated,
    warnings_heard,
)

__all__ = ["KIND"]

_SECONDS: Final = 2.0
_SECONDS_NAME: Final = "touchfield_seconds"
_HEAD_BYTES: Final = 1 << 16


def _open(path: Path, options: SourceOptions) -> BodyScene:
    mujoco = load_mujoco()
    check_files(path, anywhere=options.allow_outside)
    model, notes = _compiled(mujoco, path)
    pieces, more = pieces_of(mujoco, model, str(path), options.shell)
    seconds, rate = _seconds(mujoco, model, path, options), options.rate_hz or FRAME_RATE_HZ
    bodies = sorted({piece.body_id for piece in pieces})
    frames = frames_of(str(path), seconds, rate, len(bodies))
    tracks, told = simulated(model, bodies, frames, rate, str(path))
    track_of = dict(zip(bodies, tracks, strict=True))
    posed = [Body(piece.name, piece.scene, track_of[piece.body_id]) for piece in pieces]
    return BodyScene(posed, rate, notes=(*notes, *more, *told))


def _compiled(mujoco: Any, path: Path) -> tuple[Any, tuple[str, ...]]:
    """The model, and what MuJoCo warned of."""
    try:
        with warnings_heard(mujoco) as heard:
            model = mujoco.MjModel.from_xml_path(str(path))
    except mujoco_faults(mujoco) as error:
        raise SourceError(str(path), f"a model that MuJoCo cannot read ({error})", "a whole MJCF model") from error
    return model, tuple(f"MuJoCo warns: {' '.join(said.split())[:200]}" for said in heard)


def _seconds(mujoco: Any, model: Any, path: Path, options: SourceOptions) -> float:
    if options.seconds is not None:
        return options.seconds
    numeric = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, _SECONDS_NAME)
    if numeric < 0:
        return _SECONDS
    seconds = float(model.numeric_data[model.numeric_adr[numeric]])
    if not (seconds > 0 and math.isfinite(seconds)):
        raise SourceError(f"{path}: {_SECONDS_NAME}", f"{seconds:g}", "a positive number of seconds")
    return seconds


def _recognise(path: Path) -> bool:
    """Whether the root element is ``mujoco``: the first tag that is no declaration and no comment."""
    if path.suffix.lower() != ".xml" or not path.is_file():
        return False
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES).removeprefix(b"\xef\xbb\xbf").lstrip()
    except OSError:
        return False
    while head.startswith((b"<?", b"<!")):
        end = b"-->" if head.startswith(b"<!--") else b">"
        head = head.partition(end)[2].lstrip()
    return head.startswith(b"<mujoco") and head[7:8] in b" \t\r\n/>"


KIND = SourceKind("mjcf", "a MuJoCo model (.xml), simulated; needs the extra physics", _recognise, _open)
