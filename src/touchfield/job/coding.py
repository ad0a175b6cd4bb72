"""medium -> coder -> segments: the encoding half of figure 4, in stretches that do not need each other.

A segment is coded alone, but where it ends, and what it begins with where the world stands, depends on what is before
it. So a medium is cut into stretches of whole segments, at places that only its rate tells; each is coded without the
others, in this process or another, to the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

from touchfield.codec.registry import AnchoringEncoder, FieldEncoder
from touchfield.codec.vibration import encode_vibration
from touchfield.container import Head
from touchfield.job.executors import in_order
from touchfield.job.prepare import Prepared

if TYPE_CHECKING:
    from touchfield.codec.objects.encoder import ObjectsEncoder
    from touchfield.job.spec import EncodeSpec
    from touchfield.medium import ForceField, HapticMedium
    from touchfield.medium.medium import VibrationFrame

    """The frames of one segment; what vibrates in each, none where the medium does not vibrate; and an anchor."""
    Group = tuple[list[ForceField], list[VibrationFrame], ForceField | None]


MOST_BYTES_HELD = 1 << 27
"""A segment ends once its fields take more memory than this: eight of the largest are coded at a time."""

MOST_BYTES_UNDER_WAY = 1 << 30
"""No further segment is begun while the fields of those that are being coded take more."""


STRETCH = 4
"""Of the longest segments: where a stretch ends, one may end early."""


class Stretch(NamedTuple):
    """Frames of whole segments; of a coder with anchors the frame that the first of them is to begin like."""

    start: int
    stop: int
    anchor: int | None = None


class Coded(NamedTuple):
    """A segment: its bytes, those of what vibrates if anything does, its frames, and its samples with a force."""

    body: bytes
    vibration: bytes | None
    frames: int
    supported: int


def stretches(
    medium: HapticMedium, spec: EncodeSpec, encoder: FieldEncoder
) -> Iterator[tuple[Stretch, tuple[ForceField, ForceField] | None]]:
    """The stretches of a medium, each with its first frame and its anchor where these had to be made.

    The anchor of a stretch is that of the one before where its first frame is as good (`AnchoringEncoder.anchor`).
    """
    length, longest = spec.segment_frames_at(medium.rate_hz), spec.longest_segment_at(medium.rate_hz)
    each = STRETCH * -(-longest // length) * length
    anchor, place = None, 0
    for start in range(0, len(medium), each):
        stop = min(start + each, len(medium))
        if not isinstance(encoder, AnchoringEncoder):
            yield Stretch(start, stop), None
            continue
        first = medium[start]
        kept = encoder.anchor(first, anchor)
        if kept is first:
            anchor, place = first, start
        yield Stretch(start, stop, place), (first, kept)


def groups_of(
    medium: HapticMedium,
    spec: EncodeSpec,
    encoder: FieldEncoder,
    stretch: Stretch,
    made: tuple[ForceField, ForceField] | None = None,
    tell: Callable[[int], None] = lambda count: None,
) -> Iterator[Group]:
    """The frames of a stretch in groups, each small enough to be held in memory while it is coded.

    A frame that is the very one before does not count to a segment's length, up to that of a world that stands. Such
    a world has an anchor, the field that a segment is to begin with. `made` are the first frame and the anchor, where
    they are there; ``tell(count)`` how many frames of the medium have been made.
    """
    length, longest = spec.segment_frames_at(medium.rate_hz), spec.longest_segment_at(medium.rate_hz)
    first = made[0] if made else medium[stretch.start]
    anchor = made[1] if made else first if stretch.anchor == stretch.start else None
    if made is None and stretch.anchor is not None and anchor is None:
        anchor = medium[stretch.anchor]
    frames: list[ForceField] = []
    band: list[VibrationFrame] = []
    size = counted = 0
    others = (medium[i] for i in range(stretch.start + 1, stretch.stop))
    for i, frame in enumerate(chain([first], others), stretch.start):
        if not frames or frame is not frames[-1]:
            counted += 1
            size += frame.forces_n.nbytes
        frames.append(frame)
        if medium.vibration is not None:
            band.append(medium.vibration[i])
        tell(i + 1)
        is_full = counted == length or len(frames) == longest or size > MOST_BYTES_HELD
        if is_full or i + 1 == stretch.stop:
            if isinstance(encoder, AnchoringEncoder):
                anchor = encoder.anchor(frames[0], anchor)
            yield frames, band, anchor
            frames, band, size, counted = [], [], 0, 0


def coded_segments(encoder: FieldEncoder, vibrates: bool, groups: Iterable[Group]) -> Iterator[Coded]:
    """Each group as a segment, on all cores and in order."""

    def coded(group: Group) -> Coded:
        frames, band, anchor = group
        beside = encode_vibration(band) if vibrates else None
        if isinstance(encoder, AnchoringEncoder):
            segment = encoder.encode_segment(frames, anchor)
        else:
            segment = encoder.encode_segment(frames)
        return Coded(segment.body, beside, len(frames), sum(f.support_count for f in frames))

    def weight(group: Group) -> int:
        return sum(frame.forces_n.nbytes for frame in group[0])

    return in_order(coded, groups, weight, MOST_BYTES_UNDER_WAY)


def head_of(prepared: Prepared, encoder: FieldEncoder | ObjectsEncoder) -> Head:
    """The head of what was prepared, as it is coded."""
    medium, grid = prepared.medium, prepared.medium.grid
    return Head(
        grid_shape=grid.shape,
        spacing_m=grid.spacing_m,
        origin_m=grid.origin_m,
        rate_hz=medium.rate_hz,
        frame_count=len(medium),
        axes=medium.axes,
        device_name=prepared.device.name,
        device_type=prepared.device.type,
        force_max_n=prepared.device.force_max_n,
        mapping_scale=prepared.placement.scale,
        mapping_offset_m=prepared.placement.offset_m,
        weber_fraction=prepared.spec.k,
        force_threshold_n=prepared.spec.f0_n,
        friction=medium.friction,
        damping_n_s_per_m=medium.damping_n_s_per_m,
        tags=medium.tags,
        coder=encoder.name,
        coder_parameters=encoder.parameters,
    )
