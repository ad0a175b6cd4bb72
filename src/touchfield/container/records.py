"""The table of the ``.touch`` format, version 0: every record, every field.

The writer, the reader, docs/format.md, the fuzzing strategies and the truncation tests follow from it. A file
is an `Opening`, then records, each in a `Frame`. What changes here changes the format: a field's bytes never
change within a major version; a new record, or an old one with more fields, carries the minor version that it
came with (`Record.since_minor`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from touchfield.container.fields import LINES, NAME, Array, Listed, Octets, Real, Rest, Tag, Text, Whole
from touchfield.container.layout import Struct, row

__all__ = [
    "MAGIC",
    "MAX_OBJECTS",
    "OBJECTS_CODER",
    "RECORDS",
    "RECORD_OF",
    "REQUIRED",
    "VERSION_MAJOR",
    "VERSION_MINOR",
    "End",
    "Frame",
    "Head",
    "Index",
    "ObjectRecord",
    "Opening",
    "Pair",
    "Provenance",
    "Record",
    "Segment",
    "SegmentEntry",
    "Vibration",
    "minor_of",
]

VERSION_MAJOR: Final = 0
VERSION_MINOR: Final = 2

MAGIC: Final = b"\x89TOUCH\r\n\x1a\n"
"""As PNG's: a byte above 127, the name, and the line ends and the end-of-file mark that text modes change."""

REQUIRED: Final = 1
"""Bit 0 of a record's flags: a reader that does not know the record must refuse the file."""

OBJECTS_CODER: Final = "objects"
"""The coder whose files have OBJT records."""

MAX_OBJECTS: Final = 4096
"""OBJT records in a file."""

MAX_FRAMES: Final = (1 << 31) - 1
FRAME_COUNT: Final = Whole("u16", 1, 65535)
FIRST_FRAME: Final = Whole("u32", 0, MAX_FRAMES - 1)
LENGTH_UNIT: Final = "m"
GRID_SHAPE: Final = Array(Whole("u32", 1, 1 << 20), 3)
SPACING_M: Final = Array(Real(low=0, open_low=True), 3)
ORIGIN_M: Final = Array(Real(), 3)
SAMPLE_PLACE: Final = "Position of sample (0, 0, 0); sample (i, j, k) lies at origin_m + (i, j, k) * spacing_m."
CODER: Final = Text(32, NAME, least=1)
CODER_PARAMETERS: Final = Octets(1 << 16)


@dataclass(frozen=True, kw_only=True)
class Opening:
    """What follows the magic."""

    version_major: int = row(Whole("u16"), "A reader refuses a major version above its own.")
    version_minor: int = row(Whole("u16"), "The newest minor version of which the file has anything.")


@dataclass(frozen=True, kw_only=True)
class Frame:
    """What precedes the payload of every record."""

    tag: str = row(Tag(), "Which record it is.")
    flags: int = row(
        Whole("u16", 0, REQUIRED),
        "Bit 0: required (a reader that does not know the tag refuses the file; otherwise it skips the record). "
        "The other bits are 0.",
    )
    since_minor: int = row(Whole("u16"), "The minor version that a reader must know to read this record.")
    payload_length: int = row(Whole("u64"), "Length of the payload.", "bytes")


@dataclass(frozen=True, kw_only=True)
class Head:
    """What the whole file has in common: the lattice, the time, the device and what was promised to the hand.

    Every attribute is described by its row, and docs/format.md prints them all.
    """

    grid_shape: tuple[int, int, int] = row(GRID_SHAPE, "Samples of the lattice along x, y, z.", "samples")
    spacing_m: tuple[float, float, float] = row(
        SPACING_M, "Distance between neighbouring samples along x, y, z.", LENGTH_UNIT
    )
    origin_m: tuple[float, float, float] = row(ORIGIN_M, SAMPLE_PLACE, LENGTH_UNIT)
    rate_hz: float = row(Real(low=0, high=1e6, open_low=True), "Frames a second.", "Hz")
    frame_count: int = row(Whole("u32", 1, MAX_FRAMES), "Frames in the file.", "frames")
    axes: str = row(Text(256), 'What x, y, z mean, such as "x right, y down, z forward".')
    device_name: str = row(Text(256), "Name of the device profile that the medium was filtered for.")
    device_type: int = row(Whole("u8", 1, 2), "Paper section 5.1: 1 a point in the field, 2 an array of actuators.")
    force_max_n: float = row(Real(low=0, open_low=True), "Peak force of the device.", "N")
    mapping_scale: float = row(
        Real(low=0, open_low=True), "Metres that the hand moves for one metre of the scene.", "m/m"
    )
    mapping_offset_m: tuple[float, float, float] = row(
        Array(Real(), 3), "Point of the scene that lies at the device's origin.", LENGTH_UNIT
    )
    weber_fraction: float = row(
        Real(low=0, high=1),
        "The k of the paper's eq. 8 that was asked of the coder; whether every force keeps it is the coder's claim.",
    )
    force_threshold_n: float = row(
        Real(low=0), "F_0: differences of force up to it count as not felt; 0 where it is not used.", "N"
    )
    friction: float = row(Real(low=0), "Friction coefficient mu; the receiver renders it (paper section 3.2).")
    damping_n_s_per_m: float = row(
        Real(low=0), "Damping coefficient b; the receiver renders it (paper section 3.2).", "N s/m"
    )
    tags: tuple[str, ...] = row(Listed(Text(64), 16), 'Media tags of the paper\'s figure 1, "direct" or "symbolic".')
    coder: str = row(CODER, "Which coder made the bodies of the segments.")
    coder_parameters: bytes = row(CODER_PARAMETERS, "What that coder needs to decode them, in its own form.")


@dataclass(frozen=True, kw_only=True)
class Pair:
    """One statement about where a medium comes from."""

    key: str = row(Text(64, least=1), "What is stated; no key twice.")
    value: str = row(Text(4096, LINES), "The statement.")


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Where the medium comes from and what was done to it, for people."""

    pairs: tuple[Pair, ...] = row(Listed(Struct(Pair), 64), "Keys and values.")


@dataclass(frozen=True, kw_only=True)
class ObjectRecord:
    """One object of a haptic scene: a field in a frame of its own; the segments tell where that frame lies.

    Every attribute is described by its row, and docs/format.md prints them all.
    """

    name: str = row(Text(256), "What the object is called, for people.")
    grid_shape: tuple[int, int, int] = row(GRID_SHAPE, "Samples of its own lattice along x, y, z.", "samples")
    spacing_m: tuple[float, float, float] = row(
        SPACING_M, "Distance between neighbouring samples along x, y, z.", LENGTH_UNIT
    )
    origin_m: tuple[float, float, float] = row(ORIGIN_M, f"In its own frame. {SAMPLE_PLACE}", LENGTH_UNIT)
    is_deforming: int = row(
        Whole("u8", 0, 1), "0: one field serves all frames, and `field` holds it. 1: every frame has its own."
    )
    field_coder: str = row(CODER, "Which coder made the object's fields.")
    field_parameters: bytes = row(CODER_PARAMETERS, "What that coder needs to decode them, in its own form.")
    pose_steps: bytes = row(Octets(64), "The steps of the object's poses, in the form of the coder `objects`.")
    field: bytes = row(
        Rest(), "The field of a rigid object, as the body of a segment of one frame; nothing for one that deforms."
    )


@dataclass(frozen=True, kw_only=True)
class Segment:
    """A group of frames that decodes without any other segment."""

    first_frame: int = row(FIRST_FRAME, "Number of its first frame; the file's first frame is 0.")
    frame_count: int = row(FRAME_COUNT, "Its frames.", "frames")
    body: bytes = row(Rest(), "The frames in the coder's own form.")


@dataclass(frozen=True, kw_only=True)
class Vibration:
    """What vibrates beside the force in the frames of one segment (start of the paper's section 6.4)."""

    first_frame: int = row(FIRST_FRAME, "As in the segment that it precedes.")
    frame_count: int = row(FRAME_COUNT, "As in the segment that it precedes.", "frames")
    body: bytes = row(Rest(), "Amplitudes and frequencies, in the form of the chapter on vibration.")


@dataclass(frozen=True, kw_only=True)
class SegmentEntry:
    """Where a segment is, and which frames it holds."""

    first_frame: int = row(FIRST_FRAME, "As in the segment.")
    frame_count: int = row(FRAME_COUNT, "As in the segment.", "frames")
    offset: int = row(Whole("u64"), "Position of its SEGM record (of its tag) in the file.", "bytes")
    length: int = row(Whole("u64"), "Length of that record, from its tag to its CRC-32.", "bytes")
    crc32: int = row(Whole("u32"), "The CRC-32 at the end of that record.")


@dataclass(frozen=True, kw_only=True)
class Index:
    """All segments, in the order of their frames."""

    segments: tuple[SegmentEntry, ...] = row(
        Listed(Struct(SegmentEntry), MAX_FRAMES, "u32"),
        "The first begins at frame 0, each of the others where the one before it ends, and the last ends at "
        "`frame_count` of HEAD. They lie in the file in this order and do not overlap.",
    )


@dataclass(frozen=True, kw_only=True)
class End:
    """What a reader looks for at the end of the file."""

    index_offset: int = row(Whole("u64"), "Position of the INDX record.", "bytes")
    file_length: int = row(Whole("u64"), "Length of the whole file, this record included.", "bytes")
    chain_crc32: int = row(
        Whole("u32"),
        "CRC-32 of the opening (the magic and both versions), followed by the 4 bytes that close HEAD, the 4 bytes "
        "that close each OBJT, in their order, and the 4 bytes that close INDX: they belong to one file.",
    )


@dataclass(frozen=True)
class Record:
    """One kind of record.

    Attributes
    ----------
    tag : str
    layout : type
        The dataclass of its payload.
    required : bool
    since_minor : int
    place : str
        Where and how often it stands, in words.
    """

    tag: str
    layout: type
    required: bool
    since_minor: int
    place: str

    @property
    def kind(self) -> Struct:
        """The payload as a field type."""
        return Struct(self.layout)


RECORDS: Final = (
    Record("HEAD", Head, True, 0, "once, first"),
    Record("PROV", Provenance, False, 0, "at most once, before the first SEGM"),
    Record("OBJT", ObjectRecord, True, 1, "once for each object of coder `objects`, before the first SEGM"),
    Record("VIBR", Vibration, False, 2, "at most once for each SEGM, before it and behind the SEGM before"),
    Record("SEGM", Segment, True, 0, "once or more"),
    Record("INDX", Index, True, 0, "once, after the last SEGM"),
    Record("TEND", End, True, 0, "once, last"),
)

RECORD_OF: Final = {record.tag: record for record in RECORDS}


def minor_of(head: Head, has_vibration: bool = False) -> int:
    """The newest minor version of which a file with this head, with or without VIBR, has anything."""
    if has_vibration:
        return RECORD_OF["VIBR"].since_minor
    return RECORD_OF["OBJT"].since_minor if head.coder == OBJECTS_CODER else 0
