"""A stream as a hand feels it that moves, or holds still: `touchfield.perception.hand_motion` over its frames."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.job.spec import NO_FLOOR_N, Report, silent
from touchfield.job.stream import OpenStream, open_stream
from touchfield.medium import HapticScene
from touchfield.perception.hand_motion import HandMotion, HoldMeter, SlideMeter, SlideSpec
from touchfield.perception.human import vibration_threshold
from touchfield.render.segment_blend import with_blends

if TYPE_CHECKING:
    from touchfield.job.prepare import Prepared
    from touchfield.medium import ForceField
    from touchfield.perception.slides import Forces

__all__ = ["HandMeter", "hand_motion"]

_SLIDE_FRAMES: Final = 4


class HandMeter:
    """The hand of one stream, given its frames in order.

    Slides are measured in up to four frames, evenly spread, as they were decoded; holds over all, as a receiver plays
    them, blended where a segment starts. Voxels are felt as their fields are interpolated, objects by the receiver's
    own query of both scenes.

    Parameters
    ----------
    opened : OpenStream
    scene : HapticScene or None
        The source's objects.
    exact : callable or None
        The field that the source samples, as `Prepared.exact`.
    spec : SlideSpec, optional
    """

    def __init__(
        self,
        opened: OpenStream,
        scene: HapticScene | None = None,
        exact: Forces | None = None,
        spec: SlideSpec | None = None,
    ) -> None:
        head = opened.reader.head
        self._scene, self._coded, self._exact = scene, opened.scene, exact
        felt = opened.medium if scene is None or opened.scene is None else opened.scene
        self._played, self._blends = with_blends(felt)
        count = head.frame_count
        self._slid = set(np.linspace(0, count - 1, min(count, _SLIDE_FRAMES)).round().astype(int).tolist())
        self._starts = {segment.first_frame for segment in opened.reader.segments}
        self._slides = SlideMeter(spec)
        floor_n = head.force_threshold_n or NO_FLOOR_N
        self._hold = HoldMeter(count, head.rate_hz, head.weber_fraction, floor_n) if count > 1 else None

    def add(self, frame: int, source: ForceField, decoded: ForceField) -> None:
        """Feel one frame; both fields are on the stream's lattice."""
        ours: Forces = source.sample_n
        theirs: Forces = decoded.sample_n
        if self._scene is not None and self._coded is not None:
            ours, theirs = partial(self._scene.sample_n, frame), partial(self._coded.sample_n, frame)
        if frame in self._slid:
            self._slides.add(source, ours, theirs, self._exact)
        if self._hold is not None:
            played = self._forces_played(frame) if self._blends else None
            self._hold.add(source, ours, theirs, frame in self._starts, played)

    def _forces_played(self, frame: int) -> Forces:
        played = self._played
        return partial(played.sample_n, frame) if isinstance(played, HapticScene) else played[frame].sample_n

    def motion(self) -> HandMotion:
        """What was found."""
        hold = None if self._hold is None else self._hold.hold()
        return HandMotion(self._slides.slides(), hold, vibration_threshold())


def hand_motion(
    prepared: Prepared, stream: str | Path, spec: SlideSpec | None = None, report: Report = silent
) -> HandMotion:
    """What a hand feels of a stream beside its source.

    Parameters
    ----------
    prepared : Prepared
        What was encoded, as `prepare` or `Encoded.prepared` has it.
    stream : path
    spec : SlideSpec, optional

    Raises
    ------
    TouchfieldError
        If the stream or the source is at fault.
    """
    with open_stream(stream) as opened:
        meter, decoded = HandMeter(opened, prepared.scene, prepared.exact, spec), opened.medium
        for i in range(len(decoded)):
            meter.add(i, prepared.medium[i], decoded[i])
            report(i + 1, len(decoded))
    return meter.motion()
