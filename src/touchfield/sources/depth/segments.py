"""A depth sequence as objects: connected surfaces of each frame, followed over time (paper section 5.1).

The paper's object representation "requires a clear segmentation of the scene that is in general an ill-posed
problem", and it gives no rule. Here is a plain one, which knows nothing of what things are: what touches (a
cup and its table) is one object, and what another thing hides in part may be two.

- *Surfaces.* Two neighbouring pixels belong together if their depths z differ by at most ``step`` of the
  nearer one, or their inverse depths by at most the noise step of the sensor (`camera.noise_step_per_m`).
- *Objects.* Of a frame, the ``at-most`` largest surfaces of at least ``least``, a share of the picture.
- *Over time.* The pairs of a surface and an object are taken by the pixels that they share, the most first;
  each surface and each object once. An object that vanishes, and is seen again where it was, is the same
  (``at-most`` of those that are gone are remembered); one that moves by more than its own width between two
  frames is a new one.
- *The whole sequence.* The ``at-most`` objects with the most pixels in all frames are kept. Everything else
  that has a depth is one more object, the background. The sum of the fields is that of the whole, except at
  the borders: a plane is fitted to pixels of one object only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float32s, Int32s, Int64s
from touchfield.errors import InvalidArgument, SourceError
from touchfield.medium.pose_track import PoseTrack
from touchfield.sources.camera import DepthSequence, require_frame
from touchfield.sources.scene import Body, Scene

Labels = Int32s

LARGEST_AT_MOST: Final = 254
BACKGROUND: Final = 0

_KEPT_FRAMES = 8  # an encoder asks for each object in turn, over the frames of a segment
_KINDS: Final = {"step": float, "least": float, "at-most": int}
_EXPECTED: Final = "such as step=0.03,least=0.002,at-most=16 (least is a share of the picture)"


@dataclass(frozen=True)
class SegmentRule:
    """A rule of what belongs together, and what is an object; see the module.

    step : float; Largest difference in depth between neighbouring pixels of one surface, as a share of the
        nearer.
    least : float; Pixels of the smallest object, as a share of the picture.
    at_most : int; Objects beside the background, in a frame and in all, 1 to 254.
    """

    step: float = 0.03
    least: float = 0.002
    at_most: int = 16

    def __post_init__(self) -> None:
        for name, value in (("step", self.step), ("least", self.least)):
            if not 0 < value <= 1:
                raise InvalidArgument(f"segment {name}", repr(value), "a share above 0 and up to 1")
        if not 1 <= self.at_most <= LARGEST_AT_MOST:
            raise InvalidArgument("segment at-most", repr(self.at_most), f"1 to {LARGEST_AT_MOST} objects")

    @classmethod
    def parse(cls, text: str | None) -> SegmentRule:
        """The rule in words (``step=0.03,least=0.002,at-most=16``); None, or what is not said, is the
        default.
        """
        asked: dict[str, float | int] = {}
        for word in () if text is None else text.split(","):
            name, _, value = (part.strip() for part in word.partition("="))
            try:
                asked[name.replace("-", "_")] = _KINDS[name](value)
            except (KeyError, ValueError):
                raise InvalidArgument("--segment", repr(word.strip()), _EXPECTED) from None
        return cls(**asked)  # type: ignore[arg-type]

    @property
    def words(self) -> str:
        """The rule as `parse` reads it."""
        return f"step={self.step:g},least={self.least:g},at-most={self.at_most}"


def surfaces(depth_m: Float32s, step: float, noise_step_per_m: float) -> tuple[Labels, int]:
    """The connected surfaces of a depth map, int32 [height, width] from 1 on, 0 where unknown; and how many.

    `depth_m` float32 [height, width] is not positive, or not finite, where unknown; `step` is that of
    `SegmentRule`, `noise_step_per_m` that of the sensor, 1/m.
    """
    from scipy import ndimage

    depth = np.where(np.isfinite(depth_m), depth_m, np.float32(0))
    height, width = depth.shape
    # pixels at even places and the links between them at odd ones: then what is connected is connected in a
    # picture
    links = np.zeros((2 * height - 1, 2 * width - 1), bool)
    links[::2, ::2] = depth > 0
    for between, a, b in (
        (links[::2, 1::2], depth[:, :-1], depth[:, 1:]),
        (links[1::2, ::2], depth[:-1], depth[1:]),
    ):
        nearer = np.minimum(a, b)  # |a - b| <= max(step * nearer, g a b), as |1/a - 1/b| <= g
        allowed = np.maximum(np.float32(step) * nearer, np.float32(noise_step_per_m) * a * b)
        between[...] = (np.abs(a - b) <= allowed) & (nearer > 0)
    labels, count = ndimage.label(links)
    return np.ascontiguousarray(labels[::2, ::2], np.int32), int(count)


class _Surface(NamedTuple):
    """A large surface of a frame: its label there, and the name of the object that it is."""

    label: int
    name: int
    pixels: int


class Segmentation:
    """The objects of a depth sequence; reads every frame once, and a frame again when it is asked for.

    There are `object_count` objects beside the background, the largest first; `pixels`, int64 [frame_count,
    object_count + 1], counts those of each object in each frame, the background first.
    """

    def __init__(self, sequence: DepthSequence, rule: SegmentRule, noise_step_per_m: float) -> None:
        self.sequence, self.rule = sequence, rule
        self._noise_step_per_m = noise_step_per_m
        self._least_px = round(rule.least * sequence.width * sequence.height)
        self._known_px = np.zeros(sequence.frame_count, np.int64)
        followed = self._followed()
        totals: dict[int, int] = {}
        for surface in (one for frame in followed for one in frame):
            totals[surface.name] = totals.get(surface.name, 0) + surface.pixels
        kept = sorted(totals, key=lambda name: (-totals[name], name))[: rule.at_most]
        number = {name: place for place, name in enumerate(kept, 1)}
        self.object_count = len(kept)
        self.pixels = np.zeros((sequence.frame_count, len(kept) + 1), np.int64)
        self.pixels[:, BACKGROUND] = self._known_px
        self._numbers = [
            {one.label: number[one.name] for one in frame if one.name in number} for frame in followed
        ]
        for frame, numbers in zip(followed, self.pixels):
            for one in frame:
                if one.name in number:
                    numbers[[BACKGROUND, number[one.name]]] += (-one.pixels, one.pixels)
        self._frame = lru_cache(maxsize=_KEPT_FRAMES)(self._read)
        if not self.pixels.any():
            raise SourceError(sequence.name, "no depth in any frame", "at least one pixel with depth")

    def depth_m(self, frame: int, number: int) -> Float32s:
        """The depth of one object, metres, float32 [height, width]; 0 where it is not."""
        depth, numbers = self._frame(frame)
        return np.where(numbers == number, depth, np.float32(0))

    def _read(self, frame: int) -> tuple[Float32s, NDArray[np.uint8]]:
        """Depth, and the object of each pixel, uint8: 0 is the background, 255 where there is no depth."""
        depth = self.sequence.depth_m(frame)
        labels, count = surfaces(depth, self.rule.step, self._noise_step_per_m)
        table = np.full(count + 1, BACKGROUND, np.uint8)
        table[0] = 255
        for label, number in self._numbers[frame].items():
            table[label] = number
        return depth, table[labels]

    def _followed(self) -> list[list[_Surface]]:
        """The large surfaces of each frame."""
        sequence = self.sequence
        places: dict[int, Int64s] = {}  # by name, the latest seen last: its pixels
        followed: list[list[_Surface]] = []
        next_name = 0
        for frame in range(sequence.frame_count):
            labels, count = surfaces(sequence.depth_m(frame), self.rule.step, self._noise_step_per_m)
            flat = labels.reshape(-1)
            pixels = np.bincount(flat, minlength=count + 1)
            self._known_px[frame] = pixels[1:].sum()
            largest = 1 + np.argsort(-pixels[1:], kind="stable")[: self.rule.at_most]
            large = [int(label) for label in largest if pixels[label] >= self._least_px]
            names = _matched(flat, large, places, next_name)
            next_name = max([next_name, *(name + 1 for name in names.values())])
            gone = [name for name in places if name not in names.values()][-self.rule.at_most :]
            places = {name: places[name] for name in gone}
            places |= {name: np.flatnonzero(flat == label) for label, name in names.items()}
            followed.append([_Surface(label, name, int(pixels[label])) for label, name in names.items()])
        return followed


def _matched(labels: Labels, large: list[int], places: dict[int, Int64s], next_name: int) -> dict[int, int]:
    """A name for each of the `large` labels: of the object whose pixels, `places`, it shares most, else a new
    one.
    """
    rank = np.full(int(labels.max(initial=0)) + 1, len(large))
    rank[large] = np.arange(len(large))
    shared = [
        (-int(pixels), name, large[at])
        for name, place in places.items()
        for at, pixels in enumerate(np.bincount(rank[labels[place]], minlength=len(large) + 1)[:-1])
        if pixels
    ]
    names: dict[int, int] = {}
    for _, name, label in sorted(shared):
        if name not in names.values() and label not in names:
            names[label] = name
    for label in large:
        if label not in names:
            names[label], next_name = next_name, next_name + 1
    return names


class MaskedSequence(DepthSequence):
    """A depth sequence of which only the object of that number is known; 0 is the background."""

    def __init__(self, segmentation: Segmentation, number: int, name: str) -> None:
        source = segmentation.sequence
        self.segmentation, self.number, self.name = segmentation, number, name
        self.frame_count, self.rate_hz = source.frame_count, source.rate_hz
        self.width, self.height, self.intrinsics = source.width, source.height, source.intrinsics
        self.poses, self.notes = source.poses, source.notes

    def depth_m(self, frame: int) -> Float32s:
        require_frame(frame, self.frame_count, self.name)
        return self.segmentation.depth_m(frame, self.number)


def segmented_bodies(
    scene_maker: Callable[[DepthSequence], Scene],
    sequence: DepthSequence,
    rule: SegmentRule,
    noise_step_per_m: float,
) -> tuple[tuple[Body, ...], str]:
    """The objects of a depth sequence as bodies, the largest first and the background last; and a note."""
    objects = Segmentation(sequence, rule, noise_step_per_m)
    numbers = [n for n in (*range(1, objects.object_count + 1), BACKGROUND) if objects.pixels[:, n].any()]
    bodies = []
    for number in numbers:
        name = "background" if number == BACKGROUND else f"object {number}"
        scene = scene_maker(MaskedSequence(objects, number, f"{sequence.name}, {name}"))
        bodies.append(Body(name, scene, PoseTrack.still(sequence.frame_count)))
    rest = " and the background" if BACKGROUND in numbers else ""
    note = (
        f"Segmented by depth steps into {objects.object_count} "
        f"object{'s' * (objects.object_count != 1)}{rest} "
        f"({rule.words}); what an object is, is ill-posed (--segment)."
    )
    return tuple(bodies), note
