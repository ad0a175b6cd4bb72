"""Converts a stream to what an array of actuators (a device of type 2, paper section 5.1) plays: a medium
with one sample for each actuator, and drives from 0 to 1.

A stream that was made for an array of the same columns and rows is used unchanged. Any other is pooled onto
the actuators by the device filter, like a stored field, with the placement "fit". The drive of an actuator is
the force |F| or the amplitude of the vibration band, whichever is greater, over the force of a full drive,
clipped to 0 to 1. (Their sum would count a band that was derived from the force twice.) Departure from the
paper: its array has one panel. On a device with several panels the medium fills one, by default the front.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from touchfield.arrays import Float32s, Int64s
from touchfield.devices import Device
from touchfield.errors import InvalidArgument
from touchfield.filters.device_filter import device_medium
from touchfield.medium import Grid, HapticMedium
from touchfield.medium.grid import Placement, axis_description
from touchfield.medium.medium import VibrationFrame
from touchfield.pipeline.placement import mapping_of
from touchfield.pipeline.spec import EncodeSpec
from touchfield.pipeline.stream import OpenStream
from touchfield.sources.stored import StoredScene

PANELS: Final = ("front", "back")
"""Names of the panels of an array, in order."""


class Drives:
    """Drives of the actuators of a device, frame by frame; a frame is made on access.

    `medium` and its vibration band, if any, have (columns, rows, 1) samples. Sample (i, j, 0) is in column i;
    j counts from the top if `is_top_first`. `force_max_n` is the force of a full drive: that of the stream if
    it was made for an array, else that of the device. The medium fills one `panel` of the device (`PANELS`);
    the others stay off. InvalidArgument if the device has no such panel.
    """

    def __init__(
        self, medium: HapticMedium, device: Device, force_max_n: float, panel: str = PANELS[0]
    ) -> None:
        panels = PANELS[: device.panels]
        if panel not in panels:
            raise InvalidArgument("panel", f"{panel!r} of {device.name}", " or ".join(panels))
        self.medium, self.device, self.force_max_n = medium, device, force_max_n
        self.rate_hz, self.frame_count = medium.rate_hz, medium.frame_count
        columns, rows, _ = device.lattice
        self._shape, self._panel = (device.panels, rows, columns), panels.index(panel)
        self._flip = not is_top_first(medium.axes)

    def __len__(self) -> int:
        return self.frame_count

    def drives(self, frame: int) -> Float32s:
        """Drives of one frame, 0 to 1, float32 [panels, rows, columns] from the top left."""
        return np.maximum(*self.parts(frame))

    def parts(self, frame: int) -> tuple[Float32s, Float32s]:
        """The force and the amplitude of the vibration of one frame, each like `drives`."""
        support = self.medium[frame].support()
        forces_n = np.zeros(self._shape[:0:-1], np.float32)
        forces_n[support.positions[:, 0], support.positions[:, 1]] = support.amplitudes_n
        vibrations_n = np.zeros_like(forces_n)
        if self.medium.vibration is not None:
            vibration = self.medium.vibration(frame)
            columns_rows = (vibration.positions[:, 0], vibration.positions[:, 1])
            vibrations_n[columns_rows] = vibration.amplitudes_n
        return self._fraction(forces_n), self._fraction(vibrations_n)

    def _fraction(self, image_n: Float32s) -> Float32s:
        with np.errstate(over="ignore"):  # the F_max of a stream may be tiny
            fraction = np.minimum(image_n.astype(np.float64) / self.force_max_n, 1.0)
        return self._on_panel(fraction.astype(np.float32))

    def frequencies(self, frame: int) -> Float32s | None:
        """Frequencies of one frame, Hz, float32 [panels, rows, columns]; 0 where nothing vibrates.

        None, for every frame, if the medium has no vibration band.
        """
        band = self.medium.vibration
        if band is None:
            return None
        vibration, image_hz = band(frame), np.zeros(self._shape[:0:-1], np.float32)
        image_hz[vibration.positions[:, 0], vibration.positions[:, 1]] = vibration.frequencies_hz
        return self._on_panel(image_hz)

    def _on_panel(self, image: Float32s) -> Float32s:
        """An image [columns, rows] of the lattice as the rows of the used panel; 0 on all others."""
        rows = image.T
        panels = np.zeros(self._shape, np.float32)
        panels[self._panel] = rows[::-1] if self._flip else rows
        return panels


def array_drives(stream: OpenStream, device: Device, panel: str = PANELS[0]) -> Drives:
    """The drives of a stream on a device of type 2; the stream must stay open while they are in use.

    InvalidArgument if the device is not an array, or the stream's box has no extent.
    """
    if not device.is_array:
        raise InvalidArgument("device", f"{device.name}, a point", "an array of actuators (type 2)")
    medium, head = stream.medium, stream.reader.head
    if head.device_type == 2 and medium.grid.shape == device.lattice:
        return Drives(medium, device, head.force_max_n, panel)
    scene = StoredScene(replace(medium, vibration=None))
    mapping = mapping_of(scene, device, EncodeSpec())  # as `encode --device` does
    pooled, band = device_medium(scene, mapping), medium.vibration
    if band is not None:
        pooled = replace(pooled, vibration=_pooled_band(band, medium.grid, mapping.placement, mapping.grid))
    return Drives(pooled, device, device.force_max_n, panel)


def is_top_first(axes: str) -> bool:
    """True if the lattice's y points down, as in "x right, y down, ..." of a camera.

    The y axis of "y north", of a map, points up.
    """
    return "down" in axis_description(axes, 1)


def _pooled_band(
    band: Callable[[int], VibrationFrame], source_grid: Grid, placement: Placement, grid: Grid
) -> Callable[[int], VibrationFrame]:
    """Pool a band: the strongest vibration within each actuator's area, as frequencies have no mean."""
    spans = [_actuator_span(source_grid, placement, grid, axis) for axis in (0, 1)]

    def make(frame: int) -> VibrationFrame:
        vibration = band(frame)
        # the last write to an actuator wins: ascending order leaves the strongest sample
        order = np.argsort(vibration.amplitudes_n, kind="stable")
        (first_x, stop_x), (first_y, stop_y) = (
            (first[vibration.positions[order, axis]], stop[vibration.positions[order, axis]])
            for axis, (first, stop) in enumerate(spans)
        )
        widths, heights = stop_x - first_x, stop_y - first_y
        counts = widths * heights  # actuators of each sample
        nth = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        column, row = np.divmod(nth, np.repeat(np.maximum(heights, 1), counts))
        columns, rows = np.repeat(first_x, counts) + column, np.repeat(first_y, counts) + row
        strongest = np.full(grid.shape[:2], -1, np.int64)
        strongest[columns, rows] = np.repeat(order, counts)
        driven = np.argwhere(strongest >= 0).astype(np.int32)
        winners = strongest[driven[:, 0], driven[:, 1]]
        positions = np.concatenate([driven, np.zeros((len(driven), 1), np.int32)], axis=1)
        return VibrationFrame(
            grid, positions, vibration.amplitudes_n[winners], vibration.frequencies_hz[winners]
        )

    return make


def _actuator_span(source: Grid, placement: Placement, grid: Grid, axis: int) -> tuple[Int64s, Int64s]:
    """Start and stop of each sample's actuators along an axis.

    An actuator counts if the sample is within its area, or if its centre is within the sample's cell.
    """
    hand = placement.to_hand(source)
    middle = (hand.axis_m(axis) - grid.origin_m[axis]) / grid.spacing_m[axis]
    half = hand.spacing_m[axis] / grid.spacing_m[axis] / 2
    nearest = np.floor(middle + 0.5)
    first, last = np.minimum(nearest, np.ceil(middle - half)), np.maximum(nearest, np.ceil(middle + half) - 1)
    count = grid.shape[axis]
    first, stop = np.clip(first, 0, count), np.clip(last + 1, 0, count)
    return first.astype(np.int64), np.maximum(first, stop).astype(np.int64)
