"""Measures the alternative for `rate.py` of sending depth maps by JPEG XL, from which the receiver computes
the field.

The receiver gets depth maps, rounded to multiples of a step, and computes the field by touchfield's own code.
The depth map is used at full size or reduced by 2, 4 or 8 with a block median. Each map is coded both
directly and as indices into its list of distinct values; the smaller is used.

Voxels that exceed the mask are sent separately on the companded lattice. There are some at silhouettes at
every step, and without this patch only the exact map would keep the bound. At an NMSE, as many voxels are
sent as it takes. All sizes and steps are tried, and the smallest total counts. Camera, placement, poses and
steps count as constants.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rate_peers as peers
import rate_symbols as lattices
from rate_fields import Case, box
from rate_symbols import F0_N, K
from touchfield.filters.device_filter import device_medium
from touchfield.filters.device_spec import DeviceFilter
from touchfield.medium import ForceField
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.source import open_scene
from touchfield.sources.camera import DepthSequence, Intrinsics, noise_step_per_m
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.laws import profile_of
from touchfield.sources.scene import CAMERA_AXES, Scene
from touchfield.sources.terrain.height_scene import HeightScene

HEAD_BYTES, POSE_BYTES = 56, 24
"""Bytes of the constants, as float32.

HEAD_BYTES: camera, placement, lattice or noise step, unit and step. POSE_BYTES: a pose that is not the first.
"""
SHRINKS, STEPS = (1, 2, 4, 8), (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
"""Reductions of the map along each side, and units of the map per step."""
WORSE = 3
"""Number of consecutive steps without an improvement after which the search ends."""

Maps = NDArray[np.int32]
Forces = NDArray[np.float32]


class Decoded(DepthSequence):
    """Depth maps [frame, height, width], metres, in place of the stored ones."""

    def __init__(self, depths_m: NDArray[np.float32], camera: Intrinsics, stored: DepthSequence) -> None:
        self.name, self.rate_hz, self.intrinsics, self.depths_m = (
            "coded source",
            stored.rate_hz,
            camera,
            depths_m,
        )
        self.frame_count, self.height, self.width = depths_m.shape
        self.poses = None if stored.poses is None else stored.poses[: len(depths_m)]

    def depth_m(self, frame: int) -> NDArray[np.float32]:
        """See `DepthSequence.depth_m`."""
        depth: NDArray[np.float32] = self.depths_m[frame]
        return depth


@dataclass(frozen=True)
class Source:
    """Maps of a case, and the field computed from maps like them."""

    case: Case
    count: int

    @cached_property
    def sequence(self) -> Any:
        """The stored depth maps: a `DepthSequence` whose units are in `metres`."""
        scene: Any = open_scene(self.case.source, replace(self.case.spec.source, reading="camera"))
        return scene.sequence

    @cached_property
    def maps(self) -> Maps:
        """Stored units, int32 [frame, height, width]; 0 where unknown."""
        depths = np.stack([self.sequence.depth_m(i) for i in range(self.count)])
        units: Maps = np.rint(depths.astype(np.float64) * self.sequence.metres.units_per_m).astype(np.int32)
        return units

    @cached_property
    def unit(self) -> int:
        """Greatest common divisor of the maps: TUM stores whole millimetres in fifths."""
        return max(1, int(np.gcd.reduce(self.maps, axis=None)))

    @cached_property
    def constant_bytes(self) -> int:
        """Bytes of the constants that the receiver needs besides the maps."""
        is_moving = self.case.kind == "band" and self.sequence.poses is not None
        return HEAD_BYTES + POSE_BYTES * (self.count - 1) * is_moving

    def frames(self, maps: Maps, shrink: int) -> list[ForceField]:
        """Compute the field from maps in stored units.

        A pixel of the maps stands for `shrink` x `shrink` pixels.
        """
        scene, spec, at = (
            self._scene(maps / self.sequence.metres.units_per_m, shrink),
            self.case.spec,
            self._prepared,
        )
        law = spec.law_spec(at.device.force_max_n)
        profile = profile_of(law, math.inf if scene.is_solid else law.saturation_m)
        mapping = DeviceFilter(at.device, at.medium.grid, at.placement, profile, spec.device_filter)
        medium = device_medium(scene, mapping)
        return [medium[i] for i in range(len(maps))]

    @cached_property
    def _prepared(self) -> Any:
        return prepare(self.case.source, self.case.spec)  # for the lattice and the placement, which are sent

    def _scene(self, maps_m: NDArray[np.float64], shrink: int) -> Scene:
        stored, shift, depths_m = self.sequence, (shrink - 1) / 2, maps_m.astype(np.float32)
        if self.case.kind == "height":
            at: Any = HeightScene.from_depth_sequence(stored)._cell_m
            moved = {"x0_m": at.x0_m + shift * at.dx_m, "y0_m": at.y0_m + shift * at.dy_m}
            at = replace(at, **moved, dx_m=shrink * at.dx_m, dy_m=shrink * at.dy_m)
            return HeightScene(
                np.where(depths_m > 0, depths_m, np.nan), at, axes=CAMERA_AXES, rate_hz=stored.rate_hz
            )
        k = stored.intrinsics
        camera = Intrinsics(k.fx / shrink, k.fy / shrink, (k.cx - shift) / shrink, (k.cy - shift) / shrink)
        step_per_m = shrink * noise_step_per_m(stored.depth_m(0))
        return DepthScene(Decoded(depths_m, camera, stored), step_per_m=step_per_m)


def shrunk(maps: Maps, by: int) -> Maps:
    """Reduce maps by the median of the known pixels of each block.

    A block is unknown if fewer than half of its pixels are known.
    """
    n, height, width = maps.shape
    blocks = (
        maps.reshape(n, height // by, by, width // by, by)
        .swapaxes(2, 3)
        .reshape(n, height // by, -1, by * by)
    )
    blocks, count = np.sort(blocks, axis=-1), (blocks > 0).sum(axis=-1)
    middle = np.minimum(by * by - (count + 1) // 2, by * by - 1)[..., None]
    return np.where(2 * count >= by * by, np.take_along_axis(blocks, middle, -1)[..., 0], 0)


def map_bytes(numbers: Maps, is_final: bool) -> int:
    """Return the bytes of maps by JPEG XL.

    They are coded directly and as indices into the list of values, in one picture for all frames and, with
    `is_final`, also in one for each frame; the smallest counts.
    """
    values, indices = np.unique(numbers, return_inverse=True)
    listed = (peers.xz if is_final else peers.quick_xz)(
        np.diff(values, prepend=0).astype(np.uint16).tobytes()
    )
    sizes = []
    for symbols, extra in ((numbers, 0), (indices.reshape(numbers.shape), listed)):
        pictures = symbols.astype(np.uint8 if symbols.max(initial=0) < 256 else np.uint16)
        sizes.append(extra + peers.picture_bytes(pictures, 9 if is_final else 5))
        if is_final and len(pictures) > 1:
            sizes.append(extra + sum(peers.picture_bytes(picture[None], 9) for picture in pictures))
    return min(sizes)


def patch_bytes(original: Forces, decoded: Forces, target_db: float | None, is_final: bool = True) -> float:
    """Return the bytes of the voxels that are sent separately.

    These are all voxels beyond the mask or, with `target_db`, as few as leave this NMSE.
    """
    error, square = (((a.astype(np.float64)) ** 2).sum(axis=-1) for a in (decoded - original, original))
    is_sent = error > (0.9999 * np.maximum(F0_N, K * np.sqrt(square))) ** 2
    step = 1.0
    patch = lattices.dropped(lattices.companded(original, step), original)
    while not lattices.is_within_bound(original[is_sent], patch.decoded[is_sent]):
        step *= 0.9
        patch = lattices.dropped(lattices.companded(original, step), original)
    if target_db is not None:
        gain = (error - ((patch.decoded - original).astype(np.float64) ** 2).sum(axis=-1)).reshape(-1)
        order = np.argsort(gain)[::-1]
        enough = error.sum() - np.cumsum(np.append(0.0, gain[order])) <= square.sum() * 10 ** (target_db / 10)
        if not enough.any():
            return math.inf
        is_sent = np.zeros(error.shape, bool)
        is_sent.flat[order[: int(np.argmax(enough))]] = True
    if not is_sent.any():
        return 0
    return peers.list_bytes(patch.symbols[is_sent], is_final) + peers.mask_bytes(is_sent, is_final)


def coded_source(case: Case, frames: list[ForceField], target_db: float | None = None) -> dict[str, float]:
    """Return the fewest bytes within the error bound, with reduction and step.

    With `target_db`, at that NMSE instead. Of several frames, the first one chooses the step for each
    reduction.
    """

    def size(shrink: int, step: int, frames: list[ForceField], is_final: bool) -> float:
        numbers = np.rint(shrunk(source.maps[: len(frames)], shrink) / (source.unit * step)).astype(np.int32)
        decoded = source.frames(numbers * (source.unit * step), shrink)
        part = box([*frames, *decoded])
        original, rebuilt = (np.stack([f.to_dense()[part] for f in fields]) for fields in (frames, decoded))
        patch = patch_bytes(original, rebuilt, target_db, is_final)
        if shrink == step == 1 and patch:
            raise AssertionError("the exact map makes another field")
        return map_bytes(numbers, is_final) + patch + source.constant_bytes

    source, selected = Source(case, len(frames)), {(1, 1)}
    for shrink in SHRINKS:
        found = dict[tuple[int, int], float]()
        for step in STEPS:
            found[shrink, step] = size(shrink, step, frames[:1], False)
            if len(found) > WORSE and min(list(found.values())[-WORSE:]) > min(found.values()):
                break
        selected.add(min(found, key=found.__getitem__))
    final, (shrink, step) = min((size(*at, frames, True), at) for at in selected)
    return {"bytes": float(final), "shrink": shrink, "step": step}
