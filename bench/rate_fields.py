"""Makes the force fields of `rate.py`, from depth sequences, meshes and falling bodies.

All are made for the Phantom Omni. A *band* is a wall of 4 voxels (of the mean spacing) behind the surface of
a depth sequence. A *height* field is the same sequence read as a height map, with everything behind the
surface solid. Without the optional folder ../shared/data, they are made of the samples that the package and
its extras carry.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machine import SHARED
from touchfield.devices import device
from touchfield.medium import ForceField, HapticMedium
from touchfield.medium.stores.npz import read_npz, write_npz
from touchfield.pipeline import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.options import SourceOptions

WALL_VOXELS = 4
FRAMES = 5
SEQUENCES = {"tum": "rgbd_tum_fr1_rpy", "icl": "rgbd_iclnuim_livingroom1"}


@dataclass(frozen=True)
class Case:
    """A field to code.

    `kind` is "band", "height", "mesh" or "falling"; the frames begin at `start`.
    """

    name: str
    kind: str
    nw: int
    source: str
    spec: EncodeSpec
    start: int = 0

    @property
    def title(self) -> str:
        """Name in the tables."""
        return f"{self.name}, nw {self.nw}"

    @property
    def has_maps(self) -> bool:
        """Whether the source is a depth sequence, whose maps a peer can send."""
        return self.name.split()[0] in SEQUENCES

    def path(self, folder: Path) -> Path:
        """Return the file of at most five frames in `folder`; write it if it is missing."""
        file = folder / f"{self.name.replace(' ', '-')}-{self.nw}.npz"
        if not file.exists():
            folder.mkdir(parents=True, exist_ok=True)
            medium = prepare(self.source, self.spec).medium
            frames = [medium[i] for i in range(self.start, min(self.start + FRAMES, len(medium)))]
            write_npz(file, HapticMedium.from_frames(frames, medium.rate_hz))
        return file

    def frames(self, folder: Path) -> list[ForceField]:
        """Return the frames of `path`."""
        return list(read_npz(self.path(folder)))


def cases(sides: tuple[int, ...], names: tuple[str, ...] | None = None) -> Iterator[Case]:
    """Yield all fields at each n_w of `sides`.

    Meshes and falling bodies are yielded from n_w 6 on.
    """
    for nw in sides:
        for case in (*_depth(nw), *(_moving(nw) if nw >= 6 else ())):
            if names is None or case.name in names:
                yield case


def _depth(nw: int) -> Iterator[Case]:
    spacing_m = float(np.mean(device("phantom-omni").workspace_m)) / 2**nw
    band = EncodeSpec(nw=nw, thickness_m=WALL_VOXELS * spacing_m, source=SourceOptions(world="frames"))
    height = EncodeSpec(nw=nw, source=SourceOptions(reading="height"))
    found = {name: SHARED / folder for name, folder in SEQUENCES.items() if (SHARED / folder).is_dir()}
    for name, folder in found.items():
        yield Case(f"{name} band", "band", nw, str(folder), band)
        yield Case(f"{name} height", "height", nw, str(folder), height)
    if not found:
        yield Case("motorcycle band", "band", nw, "sample:motorcycle", band)
        yield Case("terrain height", "height", nw, "sample:terrain", EncodeSpec(nw=nw))


def _moving(nw: int) -> Iterator[Case]:
    fox = SHARED / "meshes" / "fox" / "Fox.glb"
    if fox.is_file():
        yield Case("fox", "mesh", nw, str(fox), EncodeSpec(nw=nw), start=60)
    voxels = EncodeSpec(nw=nw, representation="voxel")
    yield Case("falling", "falling", nw, "sample:falling-7", voxels, start=500)


def box(frames: list[ForceField]) -> tuple[slice, ...]:
    """Return the bounding box of the union of supports, at least one sample."""
    positions = np.concatenate([f.positions() for f in frames])
    low, high = (
        (positions.min(axis=0), positions.max(axis=0) + 1)
        if len(positions)
        else (np.zeros(3, int), np.ones(3, int))
    )
    return tuple(slice(int(a), int(b)) for a, b in zip(low, high))


@dataclass(frozen=True)
class Volume:
    """Frames as a dense array, cropped to their support: the input of the peers.

    Cropping favours the peer; the six numbers of the box count as `HEAD_BYTES`.
    """

    HEAD_BYTES = 6
    forces_n: NDArray[np.float32]
    """[frame, x, y, z, 3], newtons."""

    @classmethod
    def of(cls, frames: list[ForceField]) -> Volume:
        """Crop the frames to their `box`."""
        part = box(frames)
        return cls(np.stack([f.to_dense()[part] for f in frames]))

    @cached_property
    def energy(self) -> float:
        """Sum of |F|^2."""
        return float((self.forces_n.astype(np.float64) ** 2).sum())

    def nmse_db(self, decoded: NDArray[np.float32]) -> float:
        """Return 10 log10(sum |e|^2 / sum |F|^2)."""
        error = float(((decoded.astype(np.float64) - self.forces_n) ** 2).sum())
        return 10 * float(np.log10(max(error, 1e-30) / self.energy))
