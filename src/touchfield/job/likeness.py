"""Two media held side by side, and a medium beside the pictures of its scene (paper section 4).

"Similarity estimation", "correlation analysis between haptic media and visual media".
"""

from __future__ import annotations

import itertools
import math
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from touchfield.arrays import Float64s
from touchfield.codec.paper.field_quantiser import FieldQuantiserSpec
from touchfield.errors import InvalidArgument
from touchfield.job.joining import joined, spread, taken
from touchfield.job.mapping import SymbolFrames
from touchfield.job.prepare import prepare
from touchfield.job.spec import EncodeSpec
from touchfield.job.stream_scene import Source, StreamScene
from touchfield.measure.descriptors import DESCRIPTOR_LENGTH, descriptor, part_slots
from touchfield.measure.quantity import FewSamplesWarning
from touchfield.measure.similarity import (
    Correlation,
    Similarity,
    contact_along_axis,
    contact_along_rays,
    picture_correlation,
    similarity,
)
from touchfield.medium import HapticMedium
from touchfield.medium.grid import Placement
from touchfield.parallel import Report, silent
from touchfield.render.point_device import BOX_AXES, axes_matrix
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source
from touchfield.sources.scene import CAMERA_AXES

_LUMA: Final = (0.2126, 0.7152, 0.0722)


@dataclass(frozen=True)
class Alike:
    """How alike two media are: by their symbols where they lie, and by their descriptors wherever they lie."""

    symbols: Similarity
    parts: dict[str, float]
    frames: int
    notes: tuple[str, ...]

    @property
    def distance(self) -> float:
        """Between the descriptors, as `search` ranks; 0 for equal ones."""
        return math.sqrt(sum(d * d for d in self.parts.values()))

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        return {
            **self.symbols.summary(),
            "descriptor_distance": self.distance,
            "descriptor_parts": self.parts,
            "frames": self.frames,
        }


def similar(
    first: Source,
    second: Source,
    spec: EncodeSpec | None = None,
    *,
    quantiser: str = "weber:0.25/ico1",
    over: str = "object",
    frames: int = 8,
    report: Report = silent,
) -> Alike:
    """Compare two media, the second on the lattice and at the rate of the first.

    Each is a path, a scene, a medium or a field; `spec` tells how a scene becomes a medium. `quantiser` is Q in
    words, fitted to both at once, and coarse so that a small error of a coder is none; `over` ("voxel" or "object")
    is mu of NMI and VI, and `frames` how many of those that both have are compared, evenly spaced.

    InvalidArgument if one of them has no force, or an option is unknown.
    """
    if frames < 1:
        raise InvalidArgument("frames", f"{frames}", "1 or more")
    one, other = (prepare(source, spec).medium for source in (first, second))
    told = [np.zeros(DESCRIPTOR_LENGTH)] * 2
    for n, medium in enumerate((one, other)):
        told[n] = descriptor(medium, frames).values
        report(n + 1, 3)
    beside, notes = joined(other, one, name="the second")
    count = min(len(one), len(beside))
    places = spread(count, frames)
    media = [taken(m, places) for m in (one, beside)]
    quantise = FieldQuantiserSpec.parse(quantiser).fit(itertools.chain(*media))
    mine, theirs = (SymbolFrames(m, quantise) for m in media)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FewSamplesWarning)  # each quantity carries the note
        try:
            measured = similarity(mine, theirs, over)
        except InvalidArgument as error:
            if error.where != "symbols to compress":
                raise
            measured = similarity(mine, theirs, over, compressed=False)
            notes = (*notes, f"no NCD: {error}")
    report(3, 3)
    parts = {name: float(np.linalg.norm(told[0][slot] - told[1][slot])) for name, slot in part_slots()}
    return Alike(measured, parts, len(places), notes)


# -- a video beside -------------------------------------------------------------------------------------------------


class Looked(NamedTuple):
    """A frame of a medium beside the picture of the same time."""

    frame: int
    picture: int
    found: Correlation


def correlate(
    video: str | Path,
    stream: str | Path,
    *,
    frames: int = 4,
    reading: str = "peak",
    intrinsics: tuple[float, float, float, float] | None = None,
    source_rate_hz: float | None = None,
    report: Report = silent,
) -> tuple[Looked, ...]:
    """I(V;A) of the luma of a video and the |F| behind each pixel, at a few times, each with its test against chance.

    The picture covers the lattice as one sees it from the front. With `intrinsics` it is that of a camera at the
    origin of the scene, and |F| is met along the ray of each pixel.

    `video` is a video, a GIF, a picture or a folder of pictures, `source_rate_hz` its rate where it does not say;
    `frames` are the times that are looked at, evenly spaced over what both have, `reading` is "first" or "peak"
    (`touchfield.measure.similarity`), and `intrinsics` are fx, fy, cx, cy, pixels of the video.

    InvalidArgument or SourceError if a file cannot be read, nothing is felt within the picture, or the camera does
    not fit the medium.
    """
    if frames < 1:
        raise InvalidArgument("frames", f"{frames}", "1 or more")
    opened = StreamScene(stream)
    medium = opened.medium
    options = SourceOptions(
        kind="saliency", source_rate_hz=source_rate_hz or (medium.rate_hz if len(medium) else None)
    )
    scene: Any = open_source(video, options)
    pictures, rate_hz = scene.maps.pictures, scene.rate_hz
    last = len(medium) - 1
    if pictures.frame_count > 1:
        last = min(last, math.floor((pictures.frame_count - 1) / rate_hz * medium.rate_hz + 1e-9))
    places = spread(last + 1, frames)
    done: list[Looked] = []
    for n in places:
        at = min(round(n / medium.rate_hz * rate_hz), pictures.frame_count - 1)
        luma = pictures.picture(at).astype(np.float64) @ np.asarray(_LUMA)
        if intrinsics is None:
            luma, touched = _from_the_front(luma, medium, n, reading)
        else:
            touched = _from_the_camera(luma.shape, pictures, medium, n, opened.placement, intrinsics, reading)
        done.append(Looked(n, at, picture_correlation(luma, touched)))
        report(len(done), len(places))
    return tuple(done)


def _from_the_front(luma: Float64s, medium: HapticMedium, frame: int, reading: str) -> tuple[Float64s, Float64s]:
    """The picture as means over the columns of the lattice, and |F| of these, rows downwards."""
    from PIL import Image

    turn = axes_matrix(BOX_AXES, medium.axes)
    (right, is_left), (up, is_down), (sight, is_away) = (
        (int(np.argmax(np.abs(turn[:, n]))), bool(turn[:, n].sum() < 0)) for n in range(3)
    )
    met = contact_along_axis(medium[frame], sight, from_low=is_away, reading=reading).amplitudes_n
    seen = met if right > up else met.T  # rows along `up`, columns along `right`
    seen = seen if is_down else seen[::-1]
    seen = seen[:, ::-1] if is_left else seen
    scaled = Image.fromarray(luma.astype(np.float32)).resize(seen.shape[::-1], Image.Resampling.BOX)
    return np.asarray(scaled, np.float64), np.ascontiguousarray(seen)


def _from_the_camera(
    shape: tuple[int, ...],
    pictures: Any,
    medium: HapticMedium,
    frame: int,
    placement: Placement,
    intrinsics: tuple[float, float, float, float],
    reading: str,
) -> Float64s:
    """|F| along the ray of each pixel of the reduced picture."""
    if medium.axes != CAMERA_AXES:
        raise InvalidArgument("intrinsics", f"a medium whose axes are {medium.axes}", f"one whose are {CAMERA_AXES}")
    (fx, fy, cx, cy), (height, width) = intrinsics, shape
    v, u = np.mgrid[:height, :width]
    x = ((u + 0.5) * pictures.size[0] / width - 0.5 - cx) / fx
    y = ((v + 0.5) * pictures.size[1] / height - 0.5 - cy) / fy
    low, high = (placement.to_scene(corner) for corner in medium.grid.box_m)
    near_m, far_m = max(float(low[2]), 0.0), float(high[2])
    if not far_m > 0:
        raise InvalidArgument("intrinsics", "a workspace behind the camera", "one before it")
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    met = contact_along_rays(
        medium[frame], placement.to_hand(near_m * rays), placement.to_hand(far_m * rays), reading
    )
    return met.amplitudes_n
