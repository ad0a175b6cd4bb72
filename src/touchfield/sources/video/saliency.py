"""Turns a colour video into a haptic medium whose forces are strong where the picture catches the eye
(*visual saliency*; paper section 5.1, figure 1).

The paper's case 1: "extraction of saliency based features of the videos that are mapped to tactors". The
picture is a plate with the aspect ratio of its pixels, its longer side 1 m, row 0 at the top. Throughout the
plate the force is along +z, towards the viewer, and its amplitude is the saliency (0 to 1) times the largest
amplitude of the force law. The device filter pools, low-passes and samples the plate at the actuators of an
array. On a point device the plate is a slab in front of the hand with a depth of `THICKNESS` times its longer
side: there is no surface, and no spring. At another rate a force is held from one picture to the next.

The paper does not specify a saliency model. This one is simple and cheap, composed of published parts, on the
picture reduced to 64 pixels along its longer side:

- *Spectral residual* of the luminance (Hou & Zhang, CVPR 2007): the log amplitude spectrum minus its own 3 x
  3 mean, transformed back with the original phase and squared; it is large where the picture differs from the
  rest of itself. To avoid amplifying noise, the mean of the picture is subtracted first and amplitudes are
  weighted by A / (A + `NOISE_LEVEL`), in units of white noise.
- *Centre-surround contrast* of luminance and of the colour opponents R - G and B - (R + G) / 2 (after Itti,
  Koch & Niebur, TPAMI 1998): the absolute difference of a narrow and a wide mean, summed over the three.
- *Temporal contrast*: the same three against their own mean over the past `MEMORY_S` seconds, for motion.

Each part is divided by its past peak, which rises at once, decays over `FADE_S` seconds, and is never below
the part's value in `FLOORS`; the parts are then averaged and divided by the peak of the average in the same
way. A map therefore lies in 0..1, and frame t depends on frames 0..t only: the model can run on live pictures
(`SaliencyModel.update`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float32s, Float64s
from touchfield.errors import InvalidArgument, SourceError, require_positive
from touchfield.files import readable
from touchfield.medium import BRICK, ForceField, Grid
from touchfield.medium.budget import zero_forces
from touchfield.medium.field import field_without_empty_bricks
from touchfield.sources.camera import MAX_FRAMES, Frames, require_frame
from touchfield.sources.depth.layouts import source_rate
from touchfield.sources.images import movies as moving
from touchfield.sources.images.pictures import PHOTO_SUFFIXES, InOrder, list_files, with_suffix
from touchfield.sources.laws import ForceProfile
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import UP_Y_AXES, Scene, find_bricks_by_sphere

LONGER_SIDE_M: Final = 1.0
THICKNESS: Final = 0.05  # of the plate, as a fraction of its longer side
MEMORY_S: Final = 0.3  # time constant of the mean for temporal contrast: a few frames of a film
FADE_S: Final = 2.0  # time in which a past peak decays to 1/e
FLOORS: Final = (0.02, 0.15, 0.15)
"""Smallest peaks of spectral residual, centre-surround and temporal contrast; a step black to white is 1."""

MAX_EVEN_HZ: Final = 60.0
MAX_REPEATED: Final = 20  # frames for a picture, on average
MAX_PAUSE_S: Final = 60.0  # frames for any number of pictures
NOISE_LEVEL: Final = 0.02
"""Standard deviation of white noise that is not salient: 5 of 255 grey levels."""
_MIN_TOTAL_PEAK: Final = 1 / 3  # of the average of the parts: one part at its peak
_CENTRE_PX, _SURROUND_PX, _RESIDUAL_PX = 1.5, 8.0, 2.0  # standard deviations
_MIN_SALIENCY: Final = 1e-6  # saliency that counts as 0


@dataclass(frozen=True)
class SaliencyModel:
    """The immutable state of the model, at a rate in pictures a second.

    `mean` float32 [3, height, width] is the running mean of luminance and colour opponents, None before the
    first picture; `peaks` are the decayed peaks of spectral residual, centre-surround, temporal contrast, and
    of their average.
    """

    rate_hz: float
    mean: Float32s | None = None
    peaks: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        require_positive(rate_hz=self.rate_hz)

    def update(self, colours: NDArray[np.uint8]) -> tuple[Float32s, SaliencyModel]:
        """Return the saliency of the next picture, and the updated model.

        `colours` is the picture, sRGB, uint8 [height, width, 3].

        The saliency is float32 [map height, map width], 0 to 1, of `map_size`, row 0 at the top. Raises
        `InvalidArgument` if the picture has another size than the one before it.
        """
        from scipy.ndimage import gaussian_filter

        def smoothed(channels: Float32s, sigma_px: float) -> Float32s:
            return np.stack([gaussian_filter(channel, sigma_px, mode="nearest") for channel in channels])

        r, g, b = np.moveaxis(moving.reduced(colours).astype(np.float32) / 255, -1, 0)
        current = np.stack([0.299 * r + 0.587 * g + 0.114 * b, r - g, b - (r + g) / 2]).astype(np.float32)
        mean = current if self.mean is None else self.mean
        if mean.shape != current.shape:
            raise InvalidArgument(
                "picture", f"size {current.shape[1:]} of the map", f"{mean.shape[1:]}, as before"
            )
        contrast = np.abs(smoothed(current, _CENTRE_PX) - smoothed(current, _SURROUND_PX)).sum(axis=0)
        motion = gaussian_filter(np.abs(current - mean).sum(axis=0), 1.0, mode="nearest")
        parts = [_spectral_residual(current[0]), contrast, motion]
        fade = math.exp(-1 / (FADE_S * self.rate_hz))
        peaks = [max(float(p.max()), fade * q, floor) for p, q, floor in zip(parts, self.peaks, FLOORS)]
        total = np.mean([part / peak for part, peak in zip(parts, peaks)], axis=0)
        peaks.append(max(float(total.max()), fade * self.peaks[3], _MIN_TOTAL_PEAK))
        saliency = np.clip(total / peaks[3], 0, 1).astype(np.float32)
        fraction = np.float32(1 - math.exp(-1 / (MEMORY_S * self.rate_hz)))
        return saliency, replace(self, mean=mean + fraction * (current - mean), peaks=tuple(peaks))


def _spectral_residual(luminance: Float32s) -> Float64s:
    from scipy import ndimage

    values = luminance.astype(np.float64)
    spectrum = np.fft.fft2(values - values.mean())
    noise = NOISE_LEVEL * math.sqrt(values.size)  # the amplitude of white noise of that deviation
    amplitude = np.abs(spectrum)
    log = np.log(amplitude + noise)
    residual = log - ndimage.uniform_filter(log, 3, mode="wrap")
    salient = np.abs(np.fft.ifft2(spectrum / (amplitude + noise) * np.exp(residual))) ** 2
    # scaled so that it does not depend on the number of pixels: a spectrum of ones is one pixel of 1
    scale = 2 * math.pi * _RESIDUAL_PX**2
    return np.asarray(ndimage.gaussian_filter(salient, _RESIDUAL_PX, mode="nearest") * scale)


class EvenPictures:
    """The pictures of a video at one rate: where they are at unequal times, each stays until the next one.

    `rate_hz` is that of the shortest times between pictures then, at most `MAX_EVEN_HZ`; `is_uneven` tells.
    SourceError if pictures are so far apart that few of them would become many frames.
    """

    def __init__(self, video: moving.ColourVideo) -> None:
        self._video, self.size = video, video.size
        times_s = video.times_s - video.times_s[0]
        self.rate_hz = video.rate_hz or 0.0
        even_s = np.arange(len(times_s)) / (self.rate_hz or 1.0)
        self.is_uneven = not self.rate_hz or bool((np.abs(times_s - even_s) > 0.5 / self.rate_hz).any())
        self._pictures: Any = range(len(times_s))
        if self.is_uneven and len(times_s) > 1:
            gaps_s = np.diff(times_s)
            self.rate_hz = float(np.clip(round(1 / max(np.quantile(gaps_s, 0.1), 1e-3)), 1, MAX_EVEN_HZ))
            count = round((times_s[-1] + float(np.median(gaps_s))) * self.rate_hz)
            if count > max(MAX_PAUSE_S * self.rate_hz, MAX_REPEATED * len(times_s)):
                found = f"{len(times_s)} pictures in {times_s[-1]:.4g} s"
                raise SourceError(video.name, found, "pictures without long pauses", "Cut the video.")
            half = 0.5 / self.rate_hz  # the nearest frame, so that rounded times change nothing
            shown = np.searchsorted(times_s, np.arange(count) / self.rate_hz + half, "right") - 1
            self._pictures = np.maximum(shown, 0)
        self.frame_count = len(self._pictures)

    def values(self, frame: int) -> NDArray[np.uint8]:
        """Return the values of a frame; see ``camera.Frames``."""
        return self._video.values(int(self._pictures[frame]))


class SaliencyMaps(InOrder):
    """The saliency maps of pictures over time.

    Maps are float32 [map height, map width], 0 to 1, read-only.
    """

    def __init__(self, pictures: Frames, rate_hz: float) -> None:
        super().__init__("pictures", pictures.frame_count)
        self.pictures, self._rate_hz = pictures, rate_hz

    def _iterate(self, first: int) -> Iterator[Float32s]:
        model = SaliencyModel(self._rate_hz)
        for number in range(first, self.frame_count):
            saliency, model = model.update(self.pictures.values(number))
            saliency.flags.writeable = False
            yield saliency


class SaliencyScene(Scene):
    """The saliency of pictures over time as a plate of force; see the module.

    `pictures` have the size of the originals; their values are sRGB, uint8 [height, width, 3], reduced or
    not. `source_rate_hz` is pictures a second; `rate_hz` is frames a second of the scene, by default the
    same: a frame shows the latest picture.
    """

    tags: tuple[str, ...] = ("symbolic",)

    def __init__(
        self,
        pictures: Frames,
        source_rate_hz: float,
        rate_hz: float | None = None,
        notes: tuple[str, ...] = (),
    ) -> None:
        self.maps = SaliencyMaps(pictures, source_rate_hz)
        self.axes, self.notes = UP_Y_AXES, notes
        self.rate_hz = float(source_rate_hz if rate_hz is None else rate_hz)
        require_positive(rate_hz=self.rate_hz)
        count = pictures.frame_count
        self._step = source_rate_hz / self.rate_hz  # pictures in a frame
        if count > 1 and count / self._step > MAX_FRAMES:
            found = f"{self.rate_hz:g} Hz: {count / self._step:.3g} frames"
            raise InvalidArgument(
                "rate_hz", found, f"at most {MAX_FRAMES} frames", "Ask for a lower --rate-hz."
            )
        self.frame_count = max(1, round(count / self._step)) if count > 1 else 1
        width, height = pictures.size
        longer = max(width, height)
        self._size_m = LONGER_SIDE_M * width / longer, LONGER_SIDE_M * height / longer
        self._depth_m = THICKNESS * LONGER_SIDE_M
        columns, rows = moving.map_size(width, height)
        self._cell_m = self._size_m[0] / columns, self._size_m[1] / rows
        self.finest_m = (*self._cell_m, self._depth_m)

    def bounds_m(self) -> Float64s:
        """Return the box of the plate, metres, float64 [2, 3], centred at the origin."""
        half = np.array([*self._size_m, self._depth_m]) / 2
        return np.stack([-half, half])

    def saliency(self, frame: int) -> Float32s:
        """Return the saliency map of a frame, 0 to 1, read-only.

        It is float32 [map height, map width].

        Row 0 is at the top.
        """
        require_frame(frame, self.frame_count)
        return self.maps.at(min(self.maps.frame_count - 1, int(frame * self._step + 1e-6)))

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        """Return forces along +z: saliency times the largest amplitude of `profile`."""
        from scipy.ndimage import map_coordinates

        saliency, half_m = self.saliency(frame), self.bounds_m()[1]
        rows, columns = saliency.shape
        xs, ys, zs = (grid.origin_m[a] + grid.spacing_m[a] * np.arange(grid.shape[a]) for a in range(3))
        coordinates = np.meshgrid(
            (rows - 1) / 2 - ys / self._cell_m[1], (columns - 1) / 2 + xs / self._cell_m[0]
        )
        image = map_coordinates(saliency, coordinates, order=1, mode="nearest")  # [x, y]
        image[(image < _MIN_SALIENCY) | (np.abs(xs) > half_m[0])[:, None] | (np.abs(ys) > half_m[1])] = 0
        image *= max(abs(c + s * x) for a, b, c, s in profile.pieces for x in (a, b) if np.isfinite(x))
        slab = np.abs(zs) <= half_m[2]
        image, slab = (np.pad(part, [(0, -n % BRICK) for n in part.shape]) for part in (image, slab))
        bricks = find_bricks_by_sphere(
            lambda centres, radius_m: (np.abs(centres) <= half_m + radius_m).all(axis=1), grid
        )
        i, j, k = (bricks[:, axis, None] * BRICK + np.arange(BRICK) for axis in range(3))
        forces = zero_forces(len(bricks))
        forces[..., 2] = image[i[:, :, None, None], j[:, None, :, None]] * slab[k][:, None, None]
        return field_without_empty_bricks(grid, bricks, forces)


def open_saliency(path: Path, options: SourceOptions) -> SaliencyScene:
    """Open a video, a folder of pictures in the order of their numbers, or a picture."""
    if options.kind is None and options.depth_scale is not None:
        found = "an ordinary picture or video of 8 bits"
        mend = "Name its kind with --as saliency if that is meant."
        raise SourceError(str(path), found, "16-bit grey depth, as --depth-scale says", mend)
    with readable(path, "files that can be read"):
        if path.is_dir():
            files = list_files(path, with_suffix(*PHOTO_SUFFIXES))
            if not files:
                raise SourceError(str(path), "no picture", "PNG, JPEG, WebP, BMP or TIFF pictures")
            pictures: Any = moving.ColourPictures(files)
        elif path.suffix.lower() in moving.VIDEO_SUFFIXES:
            header = moving.video_header(path)
            if header.is_deep_grey:
                mend = "Deep grey is depth: --as depth-video."
                raise SourceError(str(path), f"a video of {header.pixels} pixels", "8 bits a colour", mend)
            pictures = moving.ColourVideo(path)
        else:
            pictures = moving.ColourPictures((path,))
    note = "Symbolic: forces show where the picture is salient, not a surface; a point device renders a slab."
    rate_hz = pictures.rate_hz or source_rate(options)
    return SaliencyScene(pictures, rate_hz, options.rate_hz, (note, *pictures.notes))


def _recognise(path: Path) -> bool:
    if path.suffix.lower() not in moving.VIDEO_SUFFIXES or not path.is_file():
        return False
    return not moving.video_header(path).is_deep_grey  # "depth-video" comes first and reports a missing extra


KIND = SourceKind(
    "saliency",
    "ordinary video (MKV, AVI, MOV, MP4, GIF; extra: video), or with --as saliency pictures or a folder of "
    "them: "
    "what catches the eye, for arrays of actuators",
    _recognise,
    open_saliency,
)
