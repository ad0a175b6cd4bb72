"""Checks whether depth pictures agree under their camera poses, and finds the reading of the poses that fits.

The points of one picture are projected into another. Where both see the same static surface, the other
picture has their depth. The *error* of a point is the distance of its depth from the range of the four pixels
around it, relative to that depth. Right poses of a Kinect or a renderer leave a median error below 0.7 % and
86 to 98 % of the points within `TOLERANCE` (docs/depth-sequences.md); wrong ones leave 0 to 58 %.

The pairs of pictures are chosen by depth alone: far enough apart for the view to have changed, near enough to
overlap. Poses that disagree are read in the other ways of `pose_form`, and in other units; a reading fits if
most points agree under it. Along a corridor the view changes so late that no frame overlaps any more under
right poses: nearer frames then decide, if they agree, and no other reading fits them better.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache
from itertools import product
from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Float32s, Float64s
from touchfield.sources.camera import CodedSequence, DepthCode, DepthSequence, Intrinsics
from touchfield.sources.depth.pose_form import FORMS, alphabetical_order, read_poses_as

TOLERANCE: Final = 0.02  # largest error of a point that agrees, as a fraction of its depth
RIGHT_FRACTION: Final = 0.95  # poses under which this fraction of the points agrees are not questioned
FIT_FRACTION: Final = 0.75  # a reading fits if this fraction agrees,
FIT_GAIN: Final = 0.5  # and it leaves at most this part of the error, and of the points that do not agree
TIE_FRACTION: Final = 0.02  # readings this near to the best fraction fit as well, if their median error is
TIE_ERROR: Final = 1.5  # at most this many times the smallest,
TIE_OFFSET: Final = 5e-4  # plus this
NEAR_TIE_FRACTION: Final = 0.005  # the same of near frames, in which wrong readings differ by little
PART_FRACTION: Final = 0.8  # a smaller fraction is noted as an agreement in part
WRONG_FRACTION: Final = 0.5  # without a reading that fits, poses are questioned below this fraction
CHANGED_FRACTION: Final = 0.3  # two pictures differ enough if at most this fraction agrees without motion
MIN_POINTS: Final = 300  # frames that share fewer points see nothing in common
MIN_POINTS_A_VIEW: Final = 150  # known points of a picture that are needed for a verdict
_HOPELESS = 0.4  # a reading under which less agrees in the first views is not measured further
_POINTS = 1500  # points of a picture that are projected
_ANCHORS = 3
_CACHED_FRAMES = 4
_DEPTH_FACTORS: Final = (0.1, 0.2, 0.25, 4.0, 5.0, 10.0)  # between the usual depth units


class Agreement(NamedTuple):
    """How well frames agree: median error and fraction of the points that agree, of `point_count` points."""

    median_error: float
    fraction: float
    point_count: int

    def __str__(self) -> str:
        if self.point_count < MIN_POINTS:
            return "the frames see nothing in common"
        error = f"{100 * self.median_error:.2g} % of the depth"
        return f"{100 * self.fraction:.0f} % of the points, median error {error}"


class PoseCheck(NamedTuple):
    """Verdict on poses: whether they agree with the depth, how well, and a note for the user."""

    is_right: bool
    agreement: Agreement
    note: str


class _Reading(NamedTuple):
    """Other poses, the option that selects them, and what it means."""

    poses: Float64s
    option: str
    meaning: str


class _View(NamedTuple):
    """Two frames, points of the first, float64 [3, n], and the depth of the second."""

    first: int
    second: int
    points: Float64s
    depth_m: Float32s


def check_poses(sequence: DepthSequence, file_poses: Float64s | None = None) -> PoseCheck | None:
    """Check the poses of a sequence against its depth.

    `file_poses` float64 [n, 4, 4] are the poses that other readings start from: those of the file, if the
    sequence has them in another form. Returns None without poses, for a single frame, and if the pictures are
    too small for a verdict.
    """
    if sequence.poses is None or sequence.is_captured or sequence.frame_count < 2:
        return None
    depth_m = lru_cache(maxsize=_CACHED_FRAMES)(sequence.depth_m)
    poses, intrinsics = np.asarray(sequence.poses, np.float64), sequence.intrinsics
    pairs = choose_pairs(sequence, depth_m)
    views = _views(pairs, depth_m, intrinsics)

    def measure(poses: Float64s, min_fraction: float = 0.0) -> Agreement:
        return _measure(views, poses, intrinsics, min_fraction)

    as_read = measure(poses)
    static = measure(np.tile(np.eye(4), (len(poses), 1, 1)))
    if static.point_count < MIN_POINTS_A_VIEW * len(views):
        return None
    if as_read.fraction >= RIGHT_FRACTION and as_read.point_count >= MIN_POINTS:
        return PoseCheck(True, as_read, f"Poses and depth agree: {as_read}.")
    form = "agree" if as_read.fraction >= PART_FRACTION else "agree in part"
    other = list(_readings(sequence, poses if file_poses is None else np.asarray(file_poses, np.float64)))
    if as_read.point_count < MIN_POINTS:
        near = _near_agreement(sequence, depth_m, pairs, other)
        if near is not None:
            return PoseCheck(True, near, f"Poses and depth of near frames agree: {near}.")
    measured = [(reading, measure(reading.poses, _HOPELESS)) for reading in other]
    best, wrong = _best_fit(measured, as_read), f"Poses and depth disagree: {as_read}"
    if best is not None:
        reading, agreement = best
        return PoseCheck(False, as_read, f"{wrong}. With {reading.option} ({reading.meaning}): {agreement}.")
    if as_read.point_count >= MIN_POINTS and as_read.fraction >= WRONG_FRACTION:
        return PoseCheck(True, as_read, f"Poses and depth {form}: {as_read}.")
    mend = "Check poses, times, camera and --depth-scale, or leave the poses out with --frame camera"
    return PoseCheck(False, as_read, f"{wrong}, and no other reading of the poses fits. {mend}.")


def _views(pairs: list[tuple[int, int]], depth_m: Callable[[int], Float32s], k: Intrinsics) -> list[_View]:
    """Return each frame of the pairs with the points that are projected into the other one."""
    both = [*pairs, *((j, i) for i, j in pairs)]
    return [_View(i, j, surface_points(depth_m(i), k), depth_m(j)) for i, j in both]


def _measure(views: list[_View], poses: Float64s, k: Intrinsics, min_fraction: float = 0.0) -> Agreement:
    """Measure how well views agree; stop after one if less than `min_fraction` agrees so far."""
    errors = np.empty(0)
    for i, j, points, depth in views:
        motion = np.linalg.inv(poses[j]) @ poses[i]
        errors = np.concatenate([errors, relative_errors(points, depth, motion, k)])
        if _agreement(errors).fraction < min_fraction:
            break
    return _agreement(errors)


def _near_agreement(
    sequence: DepthSequence,
    depth_m: Callable[[int], Float32s],
    pairs: list[tuple[int, int]],
    other: list[_Reading],
) -> Agreement | None:
    """Return how well the farthest frames agree that see something in common; None if they do not.

    The gap of each pair is halved until they do.
    """
    poses, k = np.asarray(sequence.poses, np.float64), sequence.intrinsics
    while any(j - i > 1 for i, j in pairs):
        pairs = [(i, i + max(1, (j - i) // 2)) for i, j in pairs]
        views = _views(pairs, depth_m, k)
        found = _measure(views, poses, k)
        if found.point_count >= MIN_POINTS_A_VIEW * len(views):
            best = max(_measure(views, reading.poses, k, _HOPELESS).fraction for reading in other)
            is_right = found.fraction >= max(PART_FRACTION, best - NEAR_TIE_FRACTION)
            return found if is_right else None
    return None


def choose_pairs(sequence: DepthSequence, depth_m: Callable[[int], Float32s]) -> list[tuple[int, int]]:
    """Choose pairs of frames between which the view changes, from a few places of the sequence.

    The gap is doubled until at most `CHANGED_FRACTION` of the points agree without a motion. The first gap of
    a place is half that of the place before, since a camera seldom changes its speed much.
    """
    count, still = sequence.frame_count, np.eye(4)
    pairs, gap = [], 0
    for anchor in sorted({i * count // _ANCHORS for i in range(_ANCHORS)}):
        gap = max(1, min(4, count // 8), gap // 2)
        pair = None
        while anchor + gap < count:
            pair = anchor, anchor + gap
            points = surface_points(depth_m(pair[0]), sequence.intrinsics)
            errors = relative_errors(points, depth_m(pair[1]), still, sequence.intrinsics)
            if _agreement(errors).fraction <= CHANGED_FRACTION:
                break
            gap *= 2
        if pair is not None:
            pairs.append(pair)
    return pairs


def surface_points(depth_m: Float32s, intrinsics: Intrinsics) -> Float64s:
    """Return about `_POINTS` points of a depth picture, metres, float64 [3, n], in the axes of its camera.

    `depth_m` is float32 [height, width]; pixels without depth are left out.
    """
    k, stride = intrinsics, max(1, int(np.sqrt(depth_m.size / _POINTS)))
    z = depth_m[stride // 2 :: stride, stride // 2 :: stride].astype(np.float64)
    rows, columns = np.nonzero(z > 0)
    u, v = columns * stride + stride // 2, rows * stride + stride // 2
    points: Float64s = np.stack([(u - k.cx) / k.fx, (v - k.cy) / k.fy, np.ones(len(u))]) * z[rows, columns]
    return points


def relative_errors(points: Float64s, depth_m: Float32s, motion: Float64s, k: Intrinsics) -> Float64s:
    """Return the errors of points in another depth picture, as fractions of their depth, float64 [n].

    `points` float64 [3, m] and `depth_m` float32 [height, width] are in metres; `motion` float64 [4, 4] maps
    from the camera of the points to that of the picture. Points that leave the picture or meet unknown depth
    are left out.
    """
    height, width = depth_m.shape
    points = motion[:3, :3] @ points + motion[:3, 3:]
    points = points[:, points[2] > 1e-6]
    x, y = points[0] / points[2] * k.fx + k.cx, points[1] / points[2] * k.fy + k.cy
    is_inside = (x >= 0) & (y >= 0) & (x < width - 1) & (y < height - 1)
    depth, row, column = points[2, is_inside], y[is_inside].astype(int), x[is_inside].astype(int)
    corners = np.stack([depth_m[row + i, column + j] for i in (0, 1) for j in (0, 1)])
    is_known = (corners > 0).all(axis=0)
    depth, corners = depth[is_known], corners[:, is_known]
    errors: Float64s = (
        np.maximum(np.maximum(corners.min(axis=0) - depth, depth - corners.max(axis=0)), 0) / depth
    )
    return errors


def _agreement(errors: Float64s) -> Agreement:
    if not len(errors):
        return Agreement(np.inf, 0.0, 0)
    return Agreement(float(np.median(errors)), float((errors <= TOLERANCE).mean()), len(errors))


def _readings(sequence: DepthSequence, poses: Float64s) -> Iterator[_Reading]:
    """Yield the readings of the poses, simple ones first."""
    names = sequence.frame_names
    orders = ["", "reversed"]
    if alphabetical_order(names) != list(range(len(names))):
        orders.append("alphabetical")
    quaternions = ("", "wxyz") if sequence.has_quaternions else ("",)
    axes = ("", "opengl", "ros", "mirrored")
    forms = list(product(quaternions, ("", "mm", "cm"), ("", "inverted"), axes, orders))
    for words in sorted(forms, key=lambda words: sum(map(bool, words))):
        form = tuple(filter(None, words))
        option = f"--pose-form {','.join(form)}" if form else "no --pose-form"
        meaning = "; ".join(FORMS[word] for word in form) or "scene from camera"
        yield _Reading(read_poses_as(poses, form, names), option, meaning)
    scale = _units_per_m(sequence)
    for factor in _DEPTH_FACTORS if scale else ():  # depth / factor is the same as positions * factor
        scaled = poses.copy()
        scaled[:, :3, 3] *= factor
        yield _Reading(scaled, f"--depth-scale {scale * factor:g}", "stored units in a metre")
    still = np.tile(np.eye(4), (len(poses), 1, 1))
    yield _Reading(still, "--frame camera", "the poses are not those of a camera that stands still")


def _units_per_m(sequence: DepthSequence) -> float:
    """Return the stored units in a metre, 0 if depth is stored in another way."""
    code = sequence.metres if isinstance(sequence, CodedSequence) else None
    return code.units_per_m if isinstance(code, DepthCode) else 0.0


def _best_fit(
    measured: list[tuple[_Reading, Agreement]], as_read: Agreement
) -> tuple[_Reading, Agreement] | None:
    """Return the simplest of the readings that fit as well as the best one; None if none fits.

    A reading under which the frames hardly overlap has no say.
    """
    min_count = max(MIN_POINTS, 0.3 * max(agreement.point_count for _, agreement in measured))
    min_fraction = max(FIT_FRACTION, 1 - FIT_GAIN * (1 - as_read.fraction))
    fits = [
        (reading, agreement)
        for reading, agreement in measured
        if agreement.point_count >= min_count
        and agreement.fraction >= min_fraction
        and agreement.median_error <= FIT_GAIN * as_read.median_error
    ]
    if not fits:
        return None
    best_fraction = max(agreement.fraction for _, agreement in fits) - TIE_FRACTION
    fits = [fit for fit in fits if fit[1].fraction >= best_fraction]
    best_error = TIE_ERROR * min(agreement.median_error for _, agreement in fits) + TIE_OFFSET
    return next(fit for fit in fits if fit[1].median_error <= best_error)
