"""Divides a depth sequence into objects: surfaces that are connected, tracked from frame to frame (paper
section 5.1).

The paper's object representation "requires a clear segmentation of the scene that is in general an ill-posed
problem", and gives no rule. This rule is purely geometric: touching things (a cup and its table) are one
object, and a partly occluded thing may be two.

- *Surfaces.* Two neighbouring pixels are connected if their depths z differ by at most ``step`` times the
  nearer one, or if their inverse depths differ by at most the noise step of the sensor
  (`camera.noise_step_per_m`).
- *Objects.* At most ``at-most`` surfaces of a frame are objects: the largest ones that cover at least the
  fraction ``least`` of the picture.
- *Over time.* Surfaces are matched to objects by the number of common pixels, largest first; each surface and
  each object is used once. An object that vanishes and reappears at the same position is the same object
  (``at-most`` vanished ones are remembered); one that moves by more than its own width between two frames is
  a new one.
- *Whole sequence.* The ``at-most`` objects with the most pixels in all frames are kept. All other pixels with
  depth form one more object, the background. The sum of the fields equals that of the whole scene, except at
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

OBJECT_LIMIT: Final = 254
BACKGROUND: Final = 0

_CACHED_FRAMES = 8  # an encoder reads each object in turn, over the frames of a segment
_KEYS: Final = {"step": ("step", float), "least": ("min_fraction", float), "at-most": ("max_objects", int)}
"""Field and type of `SegmentRule` for each key of its text."""
_EXPECTED: Final = "such as step=0.03,least=0.2%,at-most=16 (least: of the picture, or pixels: 600px)"


@dataclass(frozen=True)
class SegmentRule:
    """A segmentation rule; see the module.

    step : float; Largest difference in depth between neighbouring pixels of one surface, as a fraction of the
        nearer one.
    min_fraction : float; Pixels of the smallest object, as a fraction of the picture.
    min_pixels : int, optional; Pixels of the smallest object, in place of the fraction.
    max_objects : int; Objects besides the background, in a frame and in all, 1 to 254.
    """

    step: float = 0.03
    min_fraction: float = 0.002
    max_objects: int = 16
    min_pixels: int | None = None

    def __post_init__(self) -> None:
        for name, value in (("step", self.step), ("least", self.min_fraction)):
            if not 0 < value <= 1:
                expected = "a fraction above 0 and up to 1"
                hint = f"Write {value:g}px or {value:g}%." if name == "least" and 1 < value <= 100 else ""
                raise InvalidArgument(f"segment {name}", repr(value), expected, hint)
        if self.min_pixels is not None and self.min_pixels < 1:
            raise InvalidArgument("segment least", f"{self.min_pixels}px", "at least 1px")
        if not 1 <= self.max_objects <= OBJECT_LIMIT:
            raise InvalidArgument("segment at-most", repr(self.max_objects), f"1 to {OBJECT_LIMIT} objects")

    @classmethod
    def parse(cls, text: str | None) -> SegmentRule:
        """Parse a rule such as ``step=0.03,least=0.2%,at-most=16``; ``least`` is also pixels, ``600px``.

        Missing keys have their default values.
        """
        values: dict[str, float | int] = {}
        for entry in () if text is None else text.split(","):
            key, _, value = (part.strip() for part in entry.partition("="))
            try:
                name, kind = _KEYS[key]
                if key == "least" and value.endswith("px"):
                    name, kind, value = "min_pixels", int, value.removesuffix("px")
                is_percent = kind is float and value.endswith("%")
                values[name] = float(value[:-1]) / 100 if is_percent else kind(value)
            except (KeyError, ValueError):
                raise InvalidArgument("--segment", repr(entry.strip()), _EXPECTED) from None
        return cls(**values)  # type: ignore[arg-type]

    @property
    def text(self) -> str:
        """Text of the rule, as `parse` reads it."""
        least = f"{self.min_fraction:g}" if self.min_pixels is None else f"{self.min_pixels}px"
        return f"step={self.step:g},least={least},at-most={self.max_objects}"


def label_surfaces(depth_m: Float32s, step: float, noise_step_per_m: float) -> tuple[Labels, int]:
    """Label the connected surfaces of a depth map.

    Returns int32 [height, width] and their number.

    Labels start at 1; 0 is unknown.

    `depth_m` float32 [height, width] is not positive, or not finite, where unknown; `step` is that of
    `SegmentRule`, `noise_step_per_m` that of the sensor, 1/m.
    """
    from scipy import ndimage

    depth = np.where(np.isfinite(depth_m), depth_m, np.float32(0))
    height, width = depth.shape
    # pixels at even indices and links between them at odd ones, so that `label` finds the connected pixels
    links = np.zeros((2 * height - 1, 2 * width - 1), bool)
    links[::2, ::2] = depth > 0
    for link, a, b in (
        (links[::2, 1::2], depth[:, :-1], depth[:, 1:]),
        (links[1::2, ::2], depth[:-1], depth[1:]),
    ):
        nearer = np.minimum(a, b)  # |a - b| <= max(step * nearer, g a b), as |1/a - 1/b| <= g
        allowed = np.maximum(np.float32(step) * nearer, np.float32(noise_step_per_m) * a * b)
        link[...] = (np.abs(a - b) <= allowed) & (nearer > 0)
    labels, count = ndimage.label(links)
    return np.ascontiguousarray(labels[::2, ::2], np.int32), int(count)


class _Surface(NamedTuple):
    """A large surface: its label in the frame, the name of its object, and its number of pixels."""

    label: int
    name: int
    pixels: int


class Segmentation:
    """The objects of a depth sequence.

    Reads every frame once, and again when it is requested.

    There are `object_count` objects besides the background, the largest first; `pixels`, int64 [frame_count,
    object_count + 1], are the pixel counts of each object in each frame, the background first.
    """

    def __init__(self, sequence: DepthSequence, rule: SegmentRule, noise_step_per_m: float) -> None:
        self.sequence, self.rule = sequence, rule
        self._noise_step_per_m = noise_step_per_m
        self._min_px = rule.min_pixels or round(rule.min_fraction * sequence.width * sequence.height)
        self._depth_px = np.zeros(sequence.frame_count, np.int64)
        followed = self._follow_surfaces()
        totals: dict[int, int] = {}
        for frame in followed:
            for surface in frame:
                totals[surface.name] = totals.get(surface.name, 0) + surface.pixels
        names = sorted(totals, key=lambda name: (-totals[name], name))[: rule.max_objects]
        number_of = {name: number for number, name in enumerate(names, 1)}
        self.object_count = len(names)
        self.pixels = np.zeros((sequence.frame_count, len(names) + 1), np.int64)
        self.pixels[:, BACKGROUND] = self._depth_px
        self._numbers: list[dict[int, int]] = []  # of each frame, the object number of each label
        for frame, counts in zip(followed, self.pixels):
            surfaces = [surface for surface in frame if surface.name in number_of]
            self._numbers.append({surface.label: number_of[surface.name] for surface in surfaces})
            for surface in surfaces:
                counts[[BACKGROUND, number_of[surface.name]]] += (-surface.pixels, surface.pixels)
        self._frame = lru_cache(maxsize=_CACHED_FRAMES)(self._read)
        if not self.pixels.any():
            raise SourceError(sequence.name, "no depth in any frame", "at least one pixel with depth")

    def depth_m(self, frame: int, number: int) -> Float32s:
        """Return the depth of one object, metres, float32 [height, width]; 0 elsewhere."""
        depth, numbers = self._frame(frame)
        return np.where(numbers == number, depth, np.float32(0))

    def _read(self, frame: int) -> tuple[Float32s, NDArray[np.uint8]]:
        """Read depth and the object of each pixel, uint8: 0 for the background, 255 without depth."""
        depth = self.sequence.depth_m(frame)
        labels, count = label_surfaces(depth, self.rule.step, self._noise_step_per_m)
        table = np.full(count + 1, BACKGROUND, np.uint8)
        table[0] = 255
        for label, number in self._numbers[frame].items():
            table[label] = number
        return depth, table[labels]

    def _follow_surfaces(self) -> list[list[_Surface]]:
        """Return the large surfaces of each frame, matched to objects."""
        sequence = self.sequence
        pixels_of: dict[int, Int64s] = {}  # pixels of each object, by name; latest seen last
        followed: list[list[_Surface]] = []
        next_name = 0
        for frame in range(sequence.frame_count):
            labels, count = label_surfaces(sequence.depth_m(frame), self.rule.step, self._noise_step_per_m)
            flat = labels.reshape(-1)
            pixels = np.bincount(flat, minlength=count + 1)
            self._depth_px[frame] = pixels[1:].sum()
            largest = 1 + np.argsort(-pixels[1:], kind="stable")[: self.rule.max_objects]
            large = [int(label) for label in largest if pixels[label] >= self._min_px]
            names = _match_surfaces(flat, large, pixels_of, next_name)
            next_name = max([next_name, *(name + 1 for name in names.values())])
            remembered = [name for name in pixels_of if name not in names.values()][-self.rule.max_objects :]
            pixels_of = {name: pixels_of[name] for name in remembered}
            pixels_of |= {name: np.flatnonzero(flat == label) for label, name in names.items()}
            followed.append([_Surface(label, name, int(pixels[label])) for label, name in names.items()])
        return followed


def _match_surfaces(
    labels: Labels, large: list[int], pixels_of: dict[int, Int64s], next_name: int
) -> dict[int, int]:
    """Match each of the `large` labels to the object with the most common pixels, else to a new one.

    `pixels_of` are the pixel indices of the known objects by name. Returns the name of each label.
    """
    rank = np.full(int(labels.max(initial=0)) + 1, len(large))
    rank[large] = np.arange(len(large))
    shared = [
        (-int(pixels), name, large[n])
        for name, indices in pixels_of.items()
        for n, pixels in enumerate(np.bincount(rank[labels[indices]], minlength=len(large) + 1)[:-1])
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
    """The depth of one object of a sequence, unknown elsewhere.

    Number 0 is the background.
    """

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
    """Return the objects of a depth sequence as bodies, and a note.

    The largest object is first, and the background last.
    """
    objects = Segmentation(sequence, rule, noise_step_per_m)
    numbers = [n for n in (*range(1, objects.object_count + 1), BACKGROUND) if objects.pixels[:, n].any()]
    bodies = []
    for number in numbers:
        name = "background" if number == BACKGROUND else f"object {number}"
        scene = scene_maker(MaskedSequence(objects, number, f"{sequence.name}, {name}"))
        bodies.append(Body(name, scene, PoseTrack.constant(sequence.frame_count)))
    rest = " and the background" if BACKGROUND in numbers else ""
    note = (
        f"Segmented by depth steps into {objects.object_count} "
        f"object{'s' * (objects.object_count != 1)}{rest} "
        f"({rule.text}); what an object is, is ill-posed (--segment)."
    )
    return tuple(bodies), note
