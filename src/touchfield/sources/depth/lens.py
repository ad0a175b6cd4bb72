"""Lens distortion, and depth pictures resampled to the picture of one pinhole camera.

Depth along the optical axis does not depend on the distortion; only the pixel at which a point is seen does.
The samples of a distorted picture are therefore moved to the pixels at which a pinhole camera sees them. The
same resampling serves a camera whose focal length changes from frame to frame (a phone that refocuses).

Models, with the coefficients in OpenCV's order:

brown           Brown's radial and tangential polynomials, 4, 5, 8, 12 or 14 coefficients: OpenCV, ROS
                (plumb_bob, rational_polynomial), Kalibr (radtan), COLMAP, nerfstudio, RealSense
                (brown_conrady).
fisheye         Kannala and Brandt's polynomial of the angle, 4 coefficients: OpenCV's fisheye, ROS and Kalibr
                (equidistant), COLMAP, nerfstudio.
inverse-brown   RealSense's inverse_brown_conrady: Brown's polynomials from distorted to undistorted points.

OpenCV (extra: camera) computes the pixels. Without it, and for any other model, a note says that the
distortion is not undone.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np

from touchfield.arrays import Bools, Float32s
from touchfield.errors import SourceError
from touchfield.sources.camera import DepthSequence, Intrinsics

_COUNTS: Final = {"brown": (4, 5, 8, 12, 14), "inverse-brown": (4, 5, 8, 12, 14), "fisheye": (4,)}
_MODELS: Final = {
    "": "brown", "pinhole": "brown", "perspective": "brown", "plumbbob": "brown",
    "rationalpolynomial": "brown", "radtan": "brown", "radialtangential": "brown", "brownconrady": "brown",
    "modifiedbrownconrady": "brown", "opencv": "brown", "fullopencv": "brown", "radial": "brown",
    "simpleradial": "brown", "inversebrownconrady": "inverse-brown",
    "equidistant": "fisheye", "equi": "fisheye", "fisheye": "fisheye", "opencvfisheye": "fisheye",
    "kannalabrandt": "fisheye", "kannalabrandt4": "fisheye", "kannalabrandt8": "fisheye",
    "radialfisheye": "fisheye", "simpleradialfisheye": "fisheye",
}  # fmt: skip
_SMALLEST_SHIFT_PX: Final = 0.02
"""A distortion that moves no pixel further than this is left: resampling would cost more accuracy."""
_CACHED_LENSES: Final = 4
_SLOPE_LIMIT_PX: Final = 5.0  # pixel footprints of depth a pixel; as of `kernels.planes`, which needs numba


@dataclass(frozen=True)
class Distortion:
    """The distortion of a lens.

    `model` is one of the models above, or the name of a model that is not undone; `where` names the file.
    """

    model: str
    coefficients: tuple[float, ...]
    where: str

    @property
    def wording(self) -> str:
        """Description of the distortion, for a message."""
        values = ", ".join(f"{value:.4g}" for value in self.coefficients)
        return f"The lens distortion in {self.where} ({self.model}: {values})"


class Lens(NamedTuple):
    """The camera of a picture, and its distortion or None."""

    intrinsics: Intrinsics
    distortion: Distortion | None = None


def distortion_of(coefficients: Sequence[float], where: str, model: str = "") -> Distortion | None:
    """Return the distortion of these coefficients, in the order of OpenCV; None if all of them are 0.

    `model` is the name of the model in the file, in the spelling of any program; "" means Brown's. Raises
    `SourceError` for a number that is not finite.
    """
    values = tuple(float(value) for value in coefficients)
    if not all(math.isfinite(value) for value in values):
        raise SourceError(where, f"the distortion {values}", "finite coefficients")
    plain = re.sub(r"^(rs2)?distortion", "", re.sub(r"[^a-z0-9]", "", model.lower()))
    if plain == "none" or not any(values):
        return None
    name = _MODELS.get(plain, plain)
    while len(values) > 4 and values[-1] == 0:
        values = values[:-1]
    count = next((count for count in _COUNTS.get(name, ()) if count >= len(values)), None)
    if count is None:
        name = f"{model or name} of {len(values)} coefficients"
    padding = (0.0,) * ((count or 0) - len(values))
    return Distortion(name, values + padding, where)


# -- resampling --------------------------------------------------------------------------------------------
class Resampling:
    """Maps a depth picture to another one, whose pixels show the given positions in the first.

    `x_px` and `y_px` float32 [height, width]: positions in the first picture. Between four samples on one
    surface, and half a pixel outside the picture, the inverse depth is linear, which is exact on planes;
    across an edge and next to unknown samples the nearest sample is used.
    """

    def __init__(self, x_px: Float32s, y_px: Float32s, focal_px: float) -> None:
        height, width = x_px.shape
        steps = np.gradient(x_px, axis=1) * np.gradient(y_px, axis=0)
        steps -= np.gradient(x_px, axis=0) * np.gradient(y_px, axis=1)
        is_inside = (x_px > -0.5) & (x_px < width - 0.5) & (y_px > -0.5) & (y_px < height - 0.5)
        self._is_seen: Bools = is_inside & (steps > 0)  # a polynomial may fold over outside the picture
        left = np.clip(np.floor(np.where(self._is_seen, x_px, 0)), 0, width - 2).astype(np.int32)
        top = np.clip(np.floor(np.where(self._is_seen, y_px, 0)), 0, height - 2).astype(np.int32)
        x = np.clip(np.where(self._is_seen, x_px - left, 0), -0.5, 1.5).astype(np.float32)
        y = np.clip(np.where(self._is_seen, y_px - top, 0), -0.5, 1.5).astype(np.float32)
        self._corner = top * width + left
        self._offsets = (0, 1, width, width + 1)
        self._weights = ((1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y)
        self._nearest = self._corner + (x > 0.5) + width * (y > 0.5).astype(np.int32)
        self._relative_step = np.float32(_SLOPE_LIMIT_PX / focal_px)

    def __call__(self, depth_m: Float32s) -> Float32s:
        """Resample a depth picture, metres, float32 [height, width]; 0 is unknown."""
        flat = depth_m.ravel()
        corners = [flat[self._corner + offset] for offset in self._offsets]
        low, high = np.minimum.reduce(corners), np.maximum.reduce(corners)
        is_smooth = (low > 0) & (high - low <= self._relative_step * high)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = sum(weight / corner for weight, corner in zip(self._weights, corners))
            smooth = (1 / np.asarray(inverse)).astype(np.float32)
        resampled = np.where(is_smooth, smooth, flat[self._nearest])
        resampled[~self._is_seen] = 0
        return np.ascontiguousarray(resampled, np.float32)


def positions_in(lens: Lens, target: Intrinsics, size: tuple[int, int]) -> tuple[Float32s, Float32s] | None:
    """Return where the picture of a lens shows each pixel of a pinhole camera, x and y [height, width].

    Returns None if the distortion cannot be undone (see the module). `size` is width and height.
    """
    width, height = size
    distortion = lens.distortion
    v, u = np.mgrid[0:height, 0:width].astype(np.float32)
    if distortion is None:
        x = (u - target.cx) / target.fx * lens.intrinsics.fx + lens.intrinsics.cx
        y = (v - target.cy) / target.fy * lens.intrinsics.fy + lens.intrinsics.cy
        return x.astype(np.float32), y.astype(np.float32)
    cv2 = _opencv()
    if cv2 is None or distortion.model not in _COUNTS:
        return None
    coefficients = np.array(distortion.coefficients)
    of_lens, of_target = _matrix(lens.intrinsics), _matrix(target)
    if (
        distortion.model == "inverse-brown"
    ):  # its inverse, the way from undistorted points, is undistortPoints
        pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2).astype(np.float64)
        moved = cv2.undistortPoints(pixels, of_target, coefficients, None, None, of_lens)
        x, y = np.moveaxis(moved.reshape(height, width, 2), -1, 0)
        return x.astype(np.float32), y.astype(np.float32)
    maps = (cv2.fisheye if distortion.model == "fisheye" else cv2).initUndistortRectifyMap
    x, y = maps(of_lens, coefficients, np.eye(3), of_target, size, cv2.CV_32FC1)
    return x, y


def _opencv() -> Any:
    """Return OpenCV, or None if it is not installed."""
    try:
        import cv2
    except ImportError:
        return None
    return cv2


def _matrix(k: Intrinsics) -> Any:
    return np.array([[k.fx, 0, k.cx], [0, k.fy, k.cy], [0, 0, 1]])


def _resampling(lens: Lens, target: Intrinsics, size: tuple[int, int]) -> tuple[Resampling | None, float]:
    """Return the resampling of a lens, None if it is not needed or not possible, and the largest shift, px.

    The shift is NaN if it cannot be computed.
    """
    positions = positions_in(lens, target, size)
    if positions is None or min(size) < 2:
        return None, math.nan
    x, y = positions
    v, u = np.mgrid[0 : size[1], 0 : size[0]]
    is_inside = (x > -0.5) & (x < size[0] - 0.5) & (y > -0.5) & (y < size[1] - 0.5)
    shift_px = float(np.hypot(x - u, y - v)[is_inside].max(initial=0.0))
    if shift_px < _SMALLEST_SHIFT_PX and is_inside.all():
        return None, shift_px
    return Resampling(x, y, min(target.fx, target.fy)), shift_px


def undistortion(lens: Lens, size: tuple[int, int]) -> tuple[Resampling | None, tuple[str, ...]]:
    """Return the resampling that undoes the distortion of a lens, and notes for the user.

    It is None without a distortion, for one that moves no pixel by 0.02 px, and for one that is not undone.
    """
    if lens.distortion is None:
        return None, ()
    resampling, shift_px = _resampling(lens, lens.intrinsics, size)
    wording = lens.distortion.wording
    if math.isnan(shift_px):
        cause = "this model is not supported: undistort the pictures first"
        if lens.distortion.model in _COUNTS:
            cause = 'OpenCV undoes it: pip install "touchfield[camera]"'
        return None, (f"{wording} is not undone; {cause}.",)
    if resampling is None:
        return None, (f"{wording} moves no pixel by {_SMALLEST_SHIFT_PX:g} px, and is left.",)
    return resampling, (f"{wording} is undone: it moves pixels by up to {shift_px:.1f} px.",)


class RectifiedSequence(DepthSequence):
    """A depth sequence as one pinhole camera without distortion sees it.

    `lenses` are the lens of all frames, or one for each frame.
    """

    def __init__(
        self, source: DepthSequence, lenses: Sequence[Lens], target: Intrinsics, notes: tuple[str, ...] = ()
    ) -> None:
        for attribute in (*DepthSequence.__annotations__, *vars(DepthSequence)):
            if attribute[0] != "_" and not callable(getattr(DepthSequence, attribute, None)):
                setattr(self, attribute, getattr(source, attribute))
        self.source, self._lenses, self.intrinsics = source, tuple(lenses), target
        self.notes = (*source.notes, *notes)
        self._resampling = lru_cache(maxsize=_CACHED_LENSES)(self._resampling_of)

    def _resampling_of(self, lens: Lens) -> Resampling | None:
        return _resampling(lens, self.intrinsics, (self.width, self.height))[0]

    def depth_m(self, frame: int) -> Float32s:
        depth_m = self.source.depth_m(frame)
        resampling = self._resampling(self._lenses[frame if len(self._lenses) > 1 else 0])
        return depth_m if resampling is None else resampling(depth_m)

    def key_frames(self) -> Sequence[int]:
        return self.source.key_frames()


def rectified(sequence: DepthSequence, lenses: Sequence[Lens]) -> DepthSequence:
    """Return a sequence with the distortion of its lenses undone, and one camera for all frames.

    `lenses` are the lens of all frames, or one for each frame. Returns the sequence itself, with a note if
    there is a distortion, if nothing is to be resampled.
    """
    size, first = (sequence.width, sequence.height), lenses[0]
    resampling, notes = undistortion(first, size)
    cameras = np.array([(k.fx, k.fy, k.cx, k.cy) for k, _ in lenses])
    target, low, high = first.intrinsics, cameras[:, 0].min(), cameras[:, 0].max()
    has_one_camera = bool(np.ptp(cameras, axis=0).max(initial=0.0) < 1e-6)
    if not has_one_camera:
        target = Intrinsics(*np.median(cameras, axis=0).tolist())
        notes += (
            f"The camera changes from frame to frame (fx {low:.1f} to {high:.1f} px): the depth is resampled "
            f"to one camera, fx {target.fx:.1f}.",
        )
    if has_one_camera and resampling is None:
        sequence.notes = (*sequence.notes, *notes)
        return sequence
    if first.distortion is not None and resampling is None:  # left, or not undone: so in all frames
        lenses = [Lens(lens.intrinsics) for lens in lenses]
    return RectifiedSequence(sequence, lenses, target, notes)
