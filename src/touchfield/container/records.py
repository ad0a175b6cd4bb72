"""Defines format version 1 of ``.touch`` files as one table: every record, and every field of it.

The writer, the reader, the fuzzing strategies and the truncation tests are derived from it. The bytes of a
record never change: later minor versions add records with new tags, which a reader of 1.0 skips, or refuses
if they are required.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, Final

from touchfield.container.fields import (
    LINES,
    NAME,
    Array,
    Cursor,
    FieldType,
    Listed,
    Octets,
    Real,
    Rest,
    Text,
    Whole,
    quoted,
)  # fmt: skip
from touchfield.errors import InvalidArgument

ROW: Final = "touchfield row"


@dataclass(frozen=True)
class Row:
    """One field of the format.

    `kind` defines its bytes and bounds; `unit` is the physical unit, "" if there is none.
    """

    name: str
    kind: FieldType
    unit: str
    meaning: str


def row(kind: FieldType, meaning: str, unit: str = "") -> Any:
    """Declare a dataclass field together with its row of the format table."""
    return dataclasses.field(metadata={ROW: (kind, unit, meaning)})


@cache
def rows_of(layout: type) -> tuple[Row, ...]:
    """The rows of a layout, in file order."""
    return tuple(Row(field.name, *field.metadata[ROW]) for field in dataclasses.fields(layout))


class Struct(FieldType):
    """The fields of a layout in order; an instance of the dataclass in Python."""

    def __init__(self, layout: type) -> None:
        self.layout, rows = layout, rows_of(layout)
        smallest, largest = (sum(getattr(row.kind, name) for row in rows) for name in ("smallest", "largest"))
        wire, bounds = (
            [f"`{row.name}` {getattr(row.kind, name)}" for row in rows] for name in ("wire", "bounds")
        )
        super().__init__(", ".join(wire), "; ".join(bounds), smallest, largest)

    def encode(self, value: Any, where: str) -> bytes:
        if not isinstance(value, self.layout):
            raise InvalidArgument(where, quoted(value), f"a {self.layout.__name__}")
        rows = rows_of(self.layout)
        return b"".join(row.kind.encode(getattr(value, row.name), f"{where}.{row.name}") for row in rows)

    def decode(self, cursor: Cursor, where: str) -> Any:
        rows = rows_of(self.layout)
        return self.layout(**{row.name: row.kind.decode(cursor, f"{where}.{row.name}") for row in rows})


VERSION_MAJOR: Final = 1
VERSION_MINOR: Final = 0

MAGIC: Final = b"\x89TOUCH\r\n\x1a\n"
"""As in PNG: a byte above 127, the name, then line ends and an end-of-file mark, all of which a transfer as
text would change."""

REQUIRED: Final = 1
"""Bit 0 of a record's flags: a reader that does not know the record must refuse the file."""

OBJECTS_CODER: Final = "objects"
"""The coder whose files have OBJT records."""

MAX_OBJECTS: Final = 4096
"""Maximum number of OBJT records in a file."""

MAX_FRAMES: Final = (1 << 31) - 1
MAX_BRICKS: Final = 1 << 27
"""Maximum number of bricks (8 x 8 x 8 samples) of a lattice, as for 4096 x 4096 x 4096 samples."""

FRAME_COUNT: Final = Whole("u16", 1, 65535)
FIRST_FRAME: Final = Whole("u32", 0, MAX_FRAMES - 1)
GRID_SHAPE: Final = Array(Whole("u32", 1, 1 << 20), 3, MAX_BRICKS)
SPACING_M: Final = Array(Real(1e-9, 1e6), 3)
POSITION_M: Final = Array(Real(-1e9, 1e9), 3)
POSITIVE: Final = Real(1e-30, 1e30)
COEFFICIENT: Final = Real(0, 1e30)
CODER: Final = Text(32, NAME, min_bytes=1)
CODER_PARAMETERS: Final = Octets(1 << 16)


@dataclass(frozen=True, kw_only=True)
class Head:
    """Properties of the whole file: lattice, time, device, and error bound."""

    grid_shape: tuple[int, int, int] = row(GRID_SHAPE, "Samples along x, y, z.")
    spacing_m: tuple[float, float, float] = row(SPACING_M, "Distance between neighbouring samples.", "m")
    origin_m: tuple[float, float, float] = row(
        POSITION_M, "Sample (0, 0, 0); sample (i, j, k) lies at origin_m + (i, j, k) * spacing_m.", "m"
    )
    rate_hz: float = row(Real(1e-6, 1e6), "Frames a second.", "Hz")
    frame_count: int = row(Whole("u32", 1, MAX_FRAMES), "Frames in the file.")
    axes: str = row(Text(256), 'Meaning of x, y, z, such as "x right, y down, z forward".')
    device_name: str = row(Text(256), "The device that the medium was filtered for.")
    device_type: int = row(Whole("u8", 1, 2), "1 a point in the field, 2 an array of actuators.")
    force_max_n: float = row(POSITIVE, "Peak force of the device.", "N")
    mapping_scale: float = row(POSITIVE, "Metres that the hand moves for one metre of the scene.")
    mapping_offset_m: tuple[float, float, float] = row(
        POSITION_M, "Point of the scene at the device's origin.", "m"
    )
    weber_fraction: float = row(
        Real(0, 1), "The k of the error bound that was requested; the largest, if k depends on the force."
    )
    force_threshold_n: float = row(
        COEFFICIENT, "F_0: differences up to it are within the bound; 0 if not used.", "N"
    )
    friction: float = row(COEFFICIENT, "Friction coefficient, for the receiver.")
    damping_n_s_per_m: float = row(COEFFICIENT, "Damping coefficient, for the receiver.", "N s/m")
    tags: tuple[str, ...] = row(Listed(Text(64), 16), 'Media tags, such as "direct" or "symbolic".')
    coder: str = row(CODER, "Coder of the bodies of the segments.")
    coder_parameters: bytes = row(CODER_PARAMETERS, "Parameters of that coder's decoder, in its own form.")


@dataclass(frozen=True, kw_only=True)
class Pair:
    """One statement about the origin of a medium."""

    key: str = row(Text(64, min_bytes=1), "Kind of statement; every key at most once.")
    value: str = row(Text(4096, LINES), "The statement.")


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Origin and processing of the medium, for people."""

    pairs: tuple[Pair, ...] = row(Listed(Struct(Pair), 64), "Keys and values.")


@dataclass(frozen=True, kw_only=True)
class ObjectRecord:
    """One object of a haptic scene: a field in its own frame, whose poses are in the segments."""

    name: str = row(Text(256), "Name of the object, for people.")
    grid_shape: tuple[int, int, int] = row(GRID_SHAPE, "Samples of its own lattice.")
    spacing_m: tuple[float, float, float] = row(SPACING_M, "As in HEAD.", "m")
    origin_m: tuple[float, float, float] = row(POSITION_M, "As in HEAD, in the object's own frame.", "m")
    is_deforming: int = row(Whole("u8", 0, 1), "0: `field` serves all frames. 1: every frame has its own.")
    field_coder: str = row(CODER, "Coder of the object's fields.")
    field_parameters: bytes = row(CODER_PARAMETERS, "Parameters of that coder, in its own form.")
    pose_steps: bytes = row(Octets(64), "Steps of the object's poses, in the form of the coder `objects`.")
    field: bytes = row(Rest(), "If rigid, its field as the body of a segment of one frame; otherwise empty.")


@dataclass(frozen=True, kw_only=True)
class Segment:
    """A group of frames that decodes without any other segment."""

    first_frame: int = row(FIRST_FRAME, "Number of its first frame; the file's first frame is 0.")
    frame_count: int = row(FRAME_COUNT, "Its frames.")
    body: bytes = row(Rest(), "The frames in the coder's own form.")


@dataclass(frozen=True, kw_only=True)
class Vibration:
    """Vibrations in the frames of the following segment, in addition to the force (paper section 6.4)."""

    first_frame: int = row(FIRST_FRAME, "As in that segment.")
    frame_count: int = row(FRAME_COUNT, "As in that segment.")
    body: bytes = row(Rest(), "Amplitudes and frequencies.")


@dataclass(frozen=True, kw_only=True)
class SegmentEntry:
    """Position of a segment in the file, and its frames."""

    first_frame: int = row(FIRST_FRAME, "As in the segment.")
    frame_count: int = row(FRAME_COUNT, "As in the segment.")
    offset: int = row(Whole("u64"), "Position in the file of the SEGM record (of its tag).")
    length: int = row(Whole("u64"), "Bytes of that record, from its tag to its CRC-32.")
    crc32: int = row(Whole("u32"), "The CRC-32 at its end.")


@dataclass(frozen=True, kw_only=True)
class Index:
    """All segments, in the order of their frames, which is that of the file."""

    segments: tuple[SegmentEntry, ...] = row(
        Listed(Struct(SegmentEntry), MAX_FRAMES, "u32"),
        "Each starts with the frame after those of the segment before.",
    )


@dataclass(frozen=True, kw_only=True)
class End:
    """The last record, which a reader reads first: position of the index."""

    index_offset: int = row(Whole("u64"), "Position of the INDX record.")
    file_length: int = row(Whole("u64"), "Bytes of the whole file, this record included.")
    chain_crc32: int = row(
        Whole("u32"), "CRC-32 of the first 14 bytes and the CRC-32 of HEAD, each OBJT, and INDX."
    )


@dataclass(frozen=True)
class Record:
    """Kind of record: tag, dataclass of its payload, and text for its position."""

    tag: str
    layout: type
    required: bool
    position: str

    @cached_property
    def kind(self) -> Struct:
        """The payload as a field type."""
        return Struct(self.layout)


RECORDS: Final = (
    Record("HEAD", Head, True, "once, first"),
    Record("PROV", Provenance, False, "at most once, before the first SEGM"),
    Record("OBJT", ObjectRecord, True, "once for each object of coder `objects`, before the first SEGM"),
    Record("VIBR", Vibration, False, "at most once for each SEGM, between it and the SEGM before"),
    Record("SEGM", Segment, True, "once or more"),
    Record("INDX", Index, True, "once, after the last SEGM"),
    Record("TEND", End, True, "once, last"),
)

RECORD_OF: Final = {record.tag: record for record in RECORDS}
TAG_OF: Final = {record.layout: record.tag for record in RECORDS}
