"""A stream on an array of actuators (type 2, paper section 5.1): its medium there, and the drives.

A stream for an array of the same columns and rows goes through as it is; any other is pooled onto the
actuators as the device filter does it for any stored field, the placement being "fit". The drive of an
actuator is |F| over the force that drives it fully, cut to 0 to 1, or the amplitude of the vibration band
where that is greater: their sum would count a band that was made from the force twice. Departure from the
paper: its array has one panel. Of a device with several the medium fills one, in front by default.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from touchfield.arrays import Float32s, Int64s
from touchfield.devices import Device, device, device_names
from touchfield.errors import InvalidArgument
from touchfield.medium import Grid, HapticMedium
from touchfield.medium.grid import Placement, axis_words
from touchfield.medium.medium import VibrationFrame
from touchfield.pipeline.decoding import OpenStream
from touchfield.pipeline.placement import mapping_of
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.stored import StoredScene

PANELS: Final = ("front", "back")
"""Names of the panels of an array, in their order."""


class Drives:
    """Drives of the actuators of a device, frame by frame; a frame is made when it is asked for.

    `medium` is on (columns, rows, 1) samples, and so is its vibration band, if it has one. Sample (i, j, 0)
    is column i; if j counts from the top tells `is_top_first`. `force_max_n` drives an actuator fully: that
    of the stream where it was made for an array, else of the device. The medium fills one `panel` of the
    device, of `PANELS`; the others stay off. InvalidArgument if the device has no such panel.
    """

    def __init__(
        self, medium: HapticMedium, device: Device, force_max_n: float, panel: str = PANELS[0]
    ) -> None:
        there = PANELS[: device.panels]
        if panel not in there:
            raise InvalidArgument("panel", f"{panel!r} of {device.name}", " or ".join(there))
        self.medium, self.device, self.force_max_n = medium, device, force_max_n
        self.rate_hz, self.frame_count = medium.rate_hz, medium.frame_count
        columns, rows, _ = device.lattice
        self._shape, self._panel = (device.panels, rows, columns), there.index(panel)
        self._flip = not is_top_first(medium.axes)

    def __len__(self) -> int:
        return self.frame_count

    def drives(self, frame: int) -> Float32s:
        """Drives of one frame, float32 [panels, rows, columns], 0 to 1; row 0 is the top one, column 0 the
        left.
        """
        support = self.medium[frame].support()
        image_n = np.zeros(self._shape[:0:-1], np.float32)
        image_n[support.positions[:, 0], support.positions[:, 1]] = support.amplitudes_n
        band = self.medium.vibration
        if band is not None:
            one = band(frame)
            at = (one.positions[:, 0], one.positions[:, 1])
            image_n[at] = np.maximum(image_n[at], one.amplitudes_n)
        with np.errstate(over="ignore"):  # of a stream whose F_max is next to nothing
            share = np.minimum(image_n.astype(np.float64) / self.force_max_n, 1.0)
        return self._on_panel(share.astype(np.float32))

    def frequencies(self, frame: int) -> Float32s | None:
        """Frequencies of one frame, Hz, float32 [panels, rows, columns]; 0 where nothing vibrates.

        None, for every frame alike, where the medium has no band.
        """
        band = self.medium.vibration
        if band is None:
            return None
        one, image_hz = band(frame), np.zeros(self._shape[:0:-1], np.float32)
        image_hz[one.positions[:, 0], one.positions[:, 1]] = one.frequencies_hz
        return self._on_panel(image_hz)

    def _on_panel(self, image: Float32s) -> Float32s:
        """An image [columns, rows] of the lattice as the rows of the one panel, all others 0."""
        rows = image.T
        panels = np.zeros(self._shape, np.float32)
        panels[self._panel] = rows[::-1] if self._flip else rows
        return panels


def stream_device(stream: OpenStream) -> Device:
    """The profile that a stream was made for, or what it tells of one that is not known."""
    own = stream.told_device
    if own.name not in device_names():  # nor is a file looked for whose path a stream names
        return own
    known = device(own.name)
    return known if known.is_array == own.is_array else own


def array_drives(stream: OpenStream, device: Device, panel: str = PANELS[0]) -> Drives:
    """A stream on the actuators of a device of type 2; it must stay open as long as frames are asked for.

    InvalidArgument if the device is not an array, or the stream's box has no extent that could be laid over
    it.
    """
    if not device.is_array:
        raise InvalidArgument("device", f"{device.name}, a point", "an array of actuators (type 2)")
    medium, head = stream.medium, stream.reader.head
    if head.device_type == 2 and medium.grid.shape == device.lattice:
        return Drives(medium, device, head.force_max_n, panel)
    scene = StoredScene(replace(medium, vibration=None))
    mapping = mapping_of(scene, device, EncodeSpec())  # as `encode --device` does
    pooled, band = mapping.medium(scene), medium.vibration
    if band is not None:
        pooled = replace(pooled, vibration=_pooled_band(band, medium.grid, mapping.placement, mapping.grid))
    return Drives(pooled, device, device.force_max_n, panel)


def is_top_first(axes: str) -> bool:
    """True where the lattice's y counts from the top: "x right, y down, ..." as a camera has it; else y is
    up.

    "y north" of a map is up, too: the north is at the top.
    """
    return "down" in axis_words(axes, 1)


def _pooled_band(
    band: Callable[[int], VibrationFrame], own: Grid, placement: Placement, grid: Grid
) -> Callable[[int], VibrationFrame]:
    """The strongest vibration within the area of each actuator; a mean of frequencies would have no meaning."""
    reached = [_reached(own, placement, grid, axis) for axis in (0, 1)]

    def make(frame: int) -> VibrationFrame:
        one = band(frame)
        order = np.argsort(
            one.amplitudes_n, kind="stable"
        )  # of samples that share an actuator the last one stays
        (first_x, stop_x), (first_y, stop_y) = (
            (first[one.positions[order, axis]], stop[one.positions[order, axis]])
            for axis, (first, stop) in enumerate(reached)
        )
        wide, high = stop_x - first_x, stop_y - first_y
        each = wide * high
        nth = np.arange(each.sum()) - np.repeat(np.cumsum(each) - each, each)
        column, row = np.divmod(nth, np.repeat(np.maximum(high, 1), each))
        strongest = np.full(grid.shape[:2], -1, np.int64)
        strongest[np.repeat(first_x, each) + column, np.repeat(first_y, each) + row] = np.repeat(order, each)
        driven = np.argwhere(strongest >= 0).astype(np.int32)
        chosen = strongest[driven[:, 0], driven[:, 1]]
        positions = np.concatenate([driven, np.zeros((len(driven), 1), np.int32)], axis=1)
        return VibrationFrame(grid, positions, one.amplitudes_n[chosen], one.frequencies_hz[chosen])

    return make


def _reached(source: Grid, placement: Placement, grid: Grid, axis: int) -> tuple[Int64s, Int64s]:
    """First and behind the last actuator along an axis in whose area a sample lies, or whose middle in its
    cell.
    """
    hand = placement.to_hand(source)
    middle = (hand.axis_m(axis) - grid.origin_m[axis]) / grid.spacing_m[axis]
    half = hand.spacing_m[axis] / grid.spacing_m[axis] / 2
    own = np.floor(middle + 0.5)
    first, last = np.minimum(own, np.ceil(middle - half)), np.maximum(own, np.ceil(middle + half) - 1)
    count = grid.shape[axis]
    first, stop = np.clip(first, 0, count), np.clip(last + 1, 0, count)
    return first.astype(np.int64), np.maximum(first, stop).astype(np.int64)
