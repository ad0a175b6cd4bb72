"""Opens recordings of the Cluster Haptic Texture Dataset as contacts: a finger that slid along a surface.

sensor_data/force/NAME.csv     time,force   seconds, newtons: the pressing force, about 6 kHz
sensor_data/position/NAME.csv  time,X,Y     seconds, millimetres, about 100 Hz

NAME is TEXTURE_DIRECTION_SPEED_FORCE_REPEAT. Source: `touchfield data show cluster-textures`. All directions,
speeds and repeats of one texture at one pressing force are read together. Heights were not recorded: the
surface is the plane z = 0, and the force on the finger points out of it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from touchfield.errors import SourceError
from touchfield.medium.trace import ContactTrace
from touchfield.sources.options import SourceOptions
from touchfield.sources.recordings.contact_trace import ContactScene, require_world_frame
from touchfield.sources.recordings.texture_sets import ClusterName, cluster_name, folder_name, read_columns
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import Scene

_MAX_FILES: Final = 1 << 10  # of one texture and force; the set has 80
_EXPECTED: Final = "force/NAME.csv and position/NAME.csv with the same name, such as 0_135_40_500_0.csv"


class _Selection(NamedTuple):
    """The recordings of one texture and pressing force."""

    folder: Path  # of force/ and position/
    name: ClusterName  # of one of them
    files: tuple[str, ...]
    notes: tuple[str, ...]


def _folder(path: Path) -> Path | None:
    """Return the folder of force/ and position/ that a path names; None if there is none."""
    if path.is_file():
        folder = path.absolute().parent.parent
        is_member = folder_name(path) in ("force", "position") and cluster_name(path) is not None
        return folder if is_member and (folder / "force" / path.name).is_file() else None
    for folder in (path, path / "sensor_data", path / "texture_dataset" / "sensor_data"):
        if all((folder / name).is_dir() for name in ("force", "position")):
            return folder
    return None


def _names(folder: Path) -> dict[str, ClusterName]:
    named = {file.name: cluster_name(file) for file in (folder / "force").glob("*.csv")}
    return {file: name for file, name in sorted(named.items()) if name is not None}


def _select(path: Path) -> _Selection:
    folder = _folder(path)
    names = {} if folder is None else _names(folder)
    if folder is None or not names:
        raise SourceError(str(path), "no recording of the Cluster dataset", _EXPECTED)
    wanted = cluster_name(path) if path.is_file() else min(names.values(), key=lambda n: (n[0], -n.force_n))
    assert wanted is not None  # `_folder` accepts no other file
    key = (wanted.texture, wanted.force_n)
    files = tuple(file for file, name in names.items() if (name.texture, name.force_n) == key)
    if len(files) > _MAX_FILES:
        raise SourceError(str(folder), f"{len(files)} recordings of texture {key[0]}", f"up to {_MAX_FILES}")
    return _Selection(folder, wanted, files, _notes(names, wanted, len(files)))


def _notes(names: dict[str, ClusterName], wanted: ClusterName, count: int) -> tuple[str, ...]:
    counted = f"{count} recording{'s' * (count > 1)} of texture {wanted.texture} at {wanted.force_n:g} N"
    note = (
        f"{counted}: heights were not recorded, so that the surface is flat and the force points out of it."
    )
    others = sorted({(name.texture, name.force_n) for name in names.values()})
    left_out = len(others) - 1
    if not left_out:
        return (note,)
    choice = "Name a file in force/ for one of them."
    return note, f"{left_out} other combinations of texture and force are not read. {choice}"


def read_slides(path: Path) -> tuple[ContactTrace, tuple[str, ...]]:
    """Read the contacts of one texture and pressing force, and notes.

    path : folder of the set, or a file in its force/ or position/, whose texture and force are read.
    Forces are means between positions. Raises `SourceError` if there is no recording, a file cannot be read,
    or forces and positions have no common time.
    """
    selected = _select(path)
    parts = [_slide(selected.folder, file) for file in selected.files]
    positions_m, forces_n = (np.concatenate(values) for values in zip(*parts))
    return ContactTrace(positions_m, forces_n), selected.notes


def _slide(folder: Path, file: str) -> ContactTrace:
    position_file = folder / "position" / file
    if not position_file.is_file():
        raise SourceError(str(position_file), "nothing", "the positions of force/" + file, "Copy it, too.")
    positions = read_columns(position_file, ("time", "X", "Y"))
    forces = read_columns(folder / "force" / file, ("time", "force"))
    edges_s = positions[:, 0]
    counts, _ = np.histogram(forces[:, 0], edges_s)
    sums, _ = np.histogram(forces[:, 0], edges_s, weights=forces[:, 1])
    is_met = counts > 0
    if not is_met.any():
        raise SourceError(str(position_file), "no time of force/" + file, "both at the same times")
    points = np.zeros((int(is_met.sum()), 3))
    points[:, :2] = 1e-3 * ((positions[1:, 1:] + positions[:-1, 1:]) / 2)[is_met]
    pushed = np.zeros_like(points)
    pushed[:, 2] = sums[is_met] / counts[is_met]
    return ContactTrace(points, pushed)


def _recognise(path: Path) -> bool:
    folder = _folder(path)
    return folder is not None and bool(_names(folder))


def _open(path: Path, options: SourceOptions) -> Scene:
    require_world_frame(options, "a recording")
    trace, notes = read_slides(path)
    return ContactScene(trace, str(path), notes)


KIND = SourceKind(
    "cluster-textures",
    "slides of the Cluster Haptic Texture Dataset: its folder, or a .csv in sensor_data/force/",
    _recognise,
    _open,
)
