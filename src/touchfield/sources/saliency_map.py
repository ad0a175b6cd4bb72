"""Where a viewer's eye would go in a video: saliency maps, one after another, with nothing taken from the future.

The paper (section 5.1) maps the saliency of a video to tactors and leaves the model to others. This one is plain and
cheap, of published parts, on the picture reduced to 64 pixels along its longer side:

- *Spectral residual* of the luminance (Hou & Zhang, CVPR 2007): of the log amplitude spectrum its own 3 x 3 mean is
  taken off; back in the picture, with the phase kept, the square of what is left stands out where the picture is
  unlike itself elsewhere. It knows no contrast, and would lift noise to the full. Two changes mend that: the
  picture's mean is taken off before, and amplitudes are weighted by A / (A + `NOISE_LEVEL`), in units of white noise.
- *Centre-surround contrast* of luminance and of the colour opponents R - G and B - (R + G) / 2 (after Itti, Koch &
  Niebur, TPAMI 1998): the difference of a narrow and a wide mean, without a sign, the sum of the three.
- *Temporal contrast*: the same three against their own mean over the past `MEMORY_S` seconds, for what moves.

Each part is divided by its peak of the past, which rises at once and fades over `FADE_S` seconds, and is never below
a part's `FLOORS`; then the parts are averaged and divided by the peak of the average in the same way. So a map lies
in 0..1, a quiet moment does not swell to the full from one frame to the next, and frame t needs frames 0..t alone:
the model can be run on a live picture (`SaliencyModel.update`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float32s = NDArray[np.float32]

__all__ = ["LONGER_SIDE_PX", "SaliencyModel", "map_size", "reduced"]

LONGER_SIDE_PX: Final = 64
"""Of the reduced picture, as Hou & Zhang have it."""

MEMORY_S: Final = 0.3
"""Of the mean against which movement is seen: a few frames of a film."""

FADE_S: Final = 2.0
"""In which a peak of the past fades to 1/e."""

FLOORS: Final = (0.02, 0.15, 0.15)
"""Least peaks of spectral residual, centre-surround and temporal contrast; 1 is the step from black to white."""

NOISE_LEVEL: Final = 0.02
"""Standard deviation of white noise that is not worth attention, of 1: 5 of 255 grey levels."""

_LEAST_TOTAL: Final = 1 / 3  # of the averaged parts: one part alone at its peak
_CENTRE_PX, _SURROUND_PX, _RESIDUAL_PX = 1.5, 8.0, 2.0  # standard deviations


def map_size(width: int, height: int) -> tuple[int, int]:
    """Width and height of the reduced picture; a smaller picture keeps its size."""
    factor = max(1.0, max(width, height) / LONGER_SIDE_PX)
    return max(1, round(width / factor)), max(1, round(height / factor))


def reduced(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A picture, uint8 [height, width, 3], as means over the pixels of `map_size`."""
    from PIL import Image

    height, width = colours.shape[:2]
    size = map_size(width, height)
    if size == (width, height):
        return colours
    return np.asarray(Image.fromarray(colours).resize(size, Image.Resampling.BOX))


@dataclass(frozen=True)
class SaliencyModel:
    """The model with what it remembers; it is never changed, so that any moment of it can be kept.

    Attributes
    ----------
    rate_hz : float
        Pictures a second.
    mean : float32 [3, height, width] or None
        Of the past: luminance and colour opponents; None before the first picture.
    peaks : tuple of float
        Faded peaks of spectral residual, centre-surround, temporal contrast, and of their average.

    Raises
    ------
    InvalidArgument
        If the rate is not positive.
    """

    rate_hz: float
    mean: Float32s | None = None
    peaks: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not (self.rate_hz > 0 and math.isfinite(self.rate_hz)):
            raise InvalidArgument("rate_hz", repr(self.rate_hz), "a positive number")

    def update(self, colours: NDArray[np.uint8]) -> tuple[Float32s, SaliencyModel]:
        """The saliency of the next picture, and the model that has seen it.

        Parameters
        ----------
        colours : uint8 [height, width, 3]
            sRGB.

        Returns
        -------
        float32 [map height, map width]
            0 to 1, of `map_size`, row 0 at the top.
        SaliencyModel

        Raises
        ------
        InvalidArgument
            If the picture is of another size than the one before it.
        """
        now = _opponents(reduced(colours))
        mean = now if self.mean is None else self.mean
        if mean.shape != now.shape:
            raise InvalidArgument("picture", f"size {now.shape[1:]} of the map", f"{mean.shape[1:]}, as before")
        parts = [_spectral_residual(now[0]), _centre_surround(now), _smoothed(np.abs(now - mean).sum(axis=0), 1.0)]
        fade = math.exp(-1 / (FADE_S * self.rate_hz))
        peaks = [max(float(p.max()), fade * q, least) for p, q, least in zip(parts, self.peaks, FLOORS)]
        total = np.mean([part / peak for part, peak in zip(parts, peaks)], axis=0)
        peaks.append(max(float(total.max()), fade * self.peaks[3], _LEAST_TOTAL))
        saliency = np.clip(total / peaks[3], 0, 1).astype(np.float32)
        share = np.float32(1 - math.exp(-1 / (MEMORY_S * self.rate_hz)))
        return saliency, replace(self, mean=mean + share * (now - mean), peaks=tuple(peaks))


def _opponents(colours: NDArray[np.uint8]) -> Float32s:
    """Luminance, R - G and B - (R + G) / 2, float32 [3, height, width], 0..1 and -1..1."""
    r, g, b = np.moveaxis(colours.astype(np.float32) / 255, -1, 0)
    return np.stack([0.299 * r + 0.587 * g + 0.114 * b, r - g, b - (r + g) / 2]).astype(np.float32)


def _smoothed(values: NDArray[Any], sigma_px: float) -> NDArray[Any]:
    from scipy import ndimage

    smooth: NDArray[Any] = ndimage.gaussian_filter(values, sigma_px, mode="nearest")
    return smooth


def _centre_surround(channels: Float32s) -> NDArray[Any]:
    narrow, wide = (np.stack([_smoothed(c, s) for c in channels]) for s in (_CENTRE_PX, _SURROUND_PX))
    contrast: NDArray[Any] = np.abs(narrow - wide).sum(axis=0)
    return contrast


def _spectral_residual(luminance: Float32s) -> NDArray[Any]:
    from scipy import ndimage

    values = luminance.astype(np.float64)
    spectrum = np.fft.fft2(values - values.mean())
    noise = NOISE_LEVEL * math.sqrt(values.size)  # the amplitude of white noise of that deviation
    amplitude = np.abs(spectrum)
    log = np.log(amplitude + noise)
    residual = log - ndimage.uniform_filter(log, 3, mode="wrap")
    salient = np.abs(np.fft.ifft2(spectrum / (amplitude + noise) * np.exp(residual))) ** 2
    # scaled so that it does not depend on the number of pixels: a spectrum of ones is one pixel of 1
    return _smoothed(salient, _RESIDUAL_PX) * (2 * math.pi * _RESIDUAL_PX**2)
