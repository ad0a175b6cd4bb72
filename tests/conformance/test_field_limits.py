"""Every number of the format just inside and just outside its limits: three decoders agree.

The table of records is that of docs/format/container.md (`test_format_document` compares both); the limits of
vibrations and of poses are those of their chapters, repeated here.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, singledispatch
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import pytest
from second import CONFORMANCE, decoder, make_golden, reading
from test_c import CODES, COMPILER, built, run, run_with

from bit_writer import coded_poses, vibration_body
from container_strategies import OPENING, assembled, cursor_on, framed, good_bytes, refused
from live_makers import HEAD
from object_makers import ball
from touchfield.codec.objects import layout
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.codec.varint import chunk, write_varint
from touchfield.container import Head, TouchReader, TouchWriter
from touchfield.container.fields import Array, FieldType, Listed, Octets, Real, Rest, Text, Whole
from touchfield.container.records import RECORD_OF, rows_of
from touchfield.errors import FormatError
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.pipeline.decoding import open_file

pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler here")

FOLDER = Path(__file__).parent
GRID = Grid((9, 8, 10), (0.01,) * 3, (0.0,) * 3)
ENCODER = TouchEncoder(GRID, TouchSpec(effort="fast"))
FIELD = ForceField.from_support(GRID, [[1, 2, 3], [1, 2, 4]], [[0, 0, 1], [0, 0.5, 2]])


class Case(NamedTuple):
    """A file, its name, and whether readers accept it."""

    name: str
    data: bytes
    is_right: bool


# -- the records -------------------------------------------------------------------------------------------


@singledispatch
def limits(kind: FieldType) -> list[bytes]:
    """Encoded values at the limits of a field's range."""
    raise NotImplementedError(type(kind).__name__)


@limits.register
def _(kind: Whole) -> list[bytes]:
    return [value.to_bytes(kind.smallest, "little") for value in (kind.low, kind.high)]


@limits.register
def _(kind: Real) -> list[bytes]:
    return [struct.pack("<d", value) for value in (kind.low, kind.high)]


@limits.register
def _(kind: Array) -> list[bytes]:
    if kind.max_bricks is not None:  # the maximum number of bricks
        return [
            struct.pack("<3I", *shape) for shape in ((1, 1, 1), (4096, 4096, 4096), (1 << 20, 1 << 13, 8))
        ]
    return [data * kind.count for data in limits(kind.of)]


@limits.register
def _(kind: Text) -> list[bytes]:
    return [struct.pack("<H", size) + b"a" * size for size in (kind.min_bytes, kind.limit)]


@limits.register
def _(kind: Octets) -> list[bytes]:
    return [struct.pack("<I", size) + bytes(size) for size in (0, kind.limit)]


@limits.register
def _(kind: Rest) -> list[bytes]:
    return [b"", b"\0"]


@limits.register
def _(kind: Listed) -> list[bytes]:
    return [size.to_bytes(kind.smallest, "little") + good_bytes(kind.of) * size for size in (0, kind.limit)]


def write_file(head: Head, records: Callable[[TouchWriter], None]) -> bytes:
    file = io.BytesIO()
    with TouchWriter(file) as writer:
        writer.write_head(head)
        records(writer)
    return file.getvalue()


def voxels(vibration: bytes | None = None, frames: int = 1) -> bytes:
    """A small file of voxels."""
    shape = {"grid_shape": GRID.shape, "spacing_m": GRID.spacing_m, "origin_m": GRID.origin_m}
    head = replace(HEAD, frame_count=frames, coder_parameters=ENCODER.parameters, **shape)

    def records(writer: TouchWriter) -> None:
        if vibration is not None:
            writer.write_vibration(0, frames, vibration)
        writer.write_segment(0, frames, ENCODER.encode_segment([FIELD] * frames).body)

    return write_file(head, records)


def scene_file() -> bytes:
    """A small file of bodies, one of which deforms."""
    path = Path(CONFORMANCE / "v1" / "objects-touch-deforming.touch")
    return path.read_bytes()


def split(data: bytes) -> list[tuple[str, bytes]]:
    """Tags and payloads of the records of a file."""
    at, out = len(OPENING), []
    while at < len(data):
        tag, _, size = struct.unpack_from("<4sIQ", data, at)
        out.append((tag.decode(), data[at + 16 : at + 16 + size]))
        at += size + 20
    return out


def joined(records: list[tuple[str, bytes]]) -> bytes:
    """A file of records with valid CRCs, index and end, whatever the payloads are."""
    required = {tag: int(record.required) for tag, record in RECORD_OF.items()}
    coded = [
        (tag, framed(tag, payload, required[tag])) for tag, payload in records if tag not in ("INDX", "TEND")
    ]
    at, entries = len(OPENING), []
    for tag, record in coded:
        if tag == "SEGM":
            crc = record[-4:]
            entries.append(record[16:22] + struct.pack("<QQ", at, len(record)) + crc)
        at += len(record)
    index = framed("INDX", struct.pack("<I", len(entries)) + b"".join(entries))
    (_, head), *others = coded
    chained = b"".join(record[-4:] for tag, record in others if tag == "OBJT")
    return assembled(head, b"".join(record for _, record in others), index, chained=chained)


def with_payload(records: list[tuple[str, bytes]], tag: str, payload: bytes) -> bytes:
    """A file with another payload in its first record of a kind."""
    index = [name for name, _ in records].index(tag)
    return joined([*records[:index], (tag, payload), *records[index + 1 :]])


# fields whose values constrain other fields, so that a limit of one is refused because of
# another
UNFIT = {"HEAD.frame_count", "SEGM.first_frame", "SEGM.frame_count", "VIBR.first_frame", "VIBR.frame_count"}
UNFIT |= {"HEAD.coder"}  # `touch_open` refuses unsupported coders


def record_cases() -> Iterator[Case]:
    """Each row of each record at and beyond its limits."""
    vibration = vibration_body(GRID, [(np.zeros((1, 3), np.int32), np.array([9]), np.array([9]))])
    for data, tags in ((voxels(vibration), ("HEAD", "VIBR", "SEGM")), (scene_file(), ("HEAD", "OBJT"))):
        records = split(data)
        for tag in tags:
            payload, rows = dict(reversed(records))[tag], rows_of(RECORD_OF[tag].kind.layout)
            parts = [
                row.kind.encode(value, "") for row, value in zip(rows, values_of(tag, payload), strict=True)
            ]
            assert b"".join(parts) == payload
            for i, row in enumerate(rows):
                name = f"{tag}.{row.name}"
                for n, raw in enumerate(limits(row.kind)):
                    if name not in UNFIT:
                        changed = b"".join([*parts[:i], raw, *parts[i + 1 :]])
                        yield Case(f"{name} at limit {n}", with_payload(records, tag, changed), is_right=True)
                for n, (_, raw) in enumerate(refused(row.kind)):
                    if raw is not None and not (isinstance(row.kind, Rest)):
                        changed = b"".join([*parts[:i], raw, *parts[i + 1 :]])
                        yield Case(f"{name} beyond {n}", with_payload(records, tag, changed), is_right=False)


def values_of(tag: str, payload: bytes) -> list[Any]:
    cursor = cursor_on(payload)
    return [row.kind.decode(cursor, "") for row in rows_of(RECORD_OF[tag].kind.layout)]


def provenance_cases() -> Iterator[Case]:
    """PROV: pairs, keys and values at and beyond their limits."""
    records = split(voxels())

    def story(*pairs: tuple[int, int]) -> bytes:
        texts = [
            (f"{n:{size}}"[-size:] if size else "", "b" * length) for n, (size, length) in enumerate(pairs)
        ]
        coded = [struct.pack("<H", len(text)) + text.encode() for pair in texts for text in pair]
        return struct.pack("<H", len(pairs)) + b"".join(coded)

    for name, pairs, is_right in (
        ("no pair", [], True), ("64 pairs", [(2, 1)] * 64, True), ("65 pairs", [(2, 1)] * 65, False),
        ("long key", [(64, 1)], True), ("longer key", [(65, 1)], False), ("no key", [(0, 1)], False),
        ("long value", [(1, 4096)], True), ("longer value", [(1, 4097)], False), ("no value", [(1, 0)], True),
    ):  # fmt: skip
        yield Case(f"PROV {name}", joined([records[0], ("PROV", story(*pairs)), *records[1:]]), is_right)
    twice = struct.pack("<H", 2) + 2 * (struct.pack("<H", 1) + b"a" + struct.pack("<H", 0))
    yield Case("PROV a key twice", joined([records[0], ("PROV", twice), *records[1:]]), is_right=False)


def object_count_cases() -> Iterator[Case]:
    """1 to 4096 OBJT with coder `objects`, and none with another coder."""
    records = split(scene_file())
    object_records = [record for record in records if record[0] == "OBJT"]
    others = [record for record in records[1:] if record[0] != "OBJT"]
    small = (
        "OBJT",
        object_records[0][1][: 2 + len("first block") + 60] + b"\0" + struct.pack("<H", 1) + b"a" + bytes(8),
    )
    for count, is_right in ((1, True), (4096, True), (4097, False), (0, False)):
        yield Case(f"{count} OBJT", joined([records[0], *[small] * count, *others]), is_right)
    plain = split(voxels())
    yield Case("OBJT beside voxels", joined([plain[0], small, *plain[1:]]), is_right=False)


def end_cases() -> Iterator[Case]:
    """Each number of INDX and TEND, off by one either way, with valid CRCs."""
    data = voxels(frames=3)
    index = data.index(b"INDX")
    chain = zlib.crc32(data[: len(OPENING)] + data[data.index(b"SEGM") - 4 :][:4])
    payload = data[index + 16 : -44]
    for offset, size in ((0, 4), (4, 4), (8, 2), (10, 8), (18, 8), (26, 4)):
        for step in (-1, 1):
            number = (int.from_bytes(payload[offset : offset + size], "little") + step) % (1 << 8 * size)
            record = framed(
                "INDX", payload[:offset] + number.to_bytes(size, "little") + payload[offset + size :]
            )
            end = struct.pack("<QQI", index, len(data), zlib.crc32(record[-4:], chain))
            yield Case(
                f"INDX at {offset} {step:+}", data[:index] + record + framed("TEND", end), is_right=False
            )
    numbers = struct.unpack("<QQI", data[-24:-4])
    for number_index in range(3):
        for step in (-1, 0, 1):
            changed = [number + step * (n == number_index) for n, number in enumerate(numbers)]
            name = f"TEND at {number_index} {step:+}"
            yield Case(name, data[:-40] + framed("TEND", struct.pack("<QQI", *changed)), is_right=not step)


def test_container_readers_have_the_same_limits(tmp_path: Path) -> None:
    folder = CONFORMANCE.parent / "c"
    program = built(tmp_path, "open", "-O1", f"-I{folder}", source=FOLDER / "open.c")
    cases = [*record_cases(), *provenance_cases(), *object_count_cases(), *end_cases()]
    paths = [tmp_path / f"{n}.touch" for n in range(len(cases))]
    for path, case in zip(paths, cases, strict=True):
        path.write_bytes(case.data)
    code, printed = run_with(program, *paths)
    assert code == 0 and len(printed.split()) == len(cases) > 300
    wrong = []
    for case, line in zip(cases, printed.split(), strict=True):
        found = [error_of_package(case.data), error_of_reference_decoder(case.data), CODES[int(line)]]
        expected = "" if case.is_right else "CorruptFile"
        if found != [expected] * 3:
            wrong.append(f"{case.name}: {found}, expected {expected!r}")
    assert not wrong, "\n".join(wrong)


def error_of_package(data: bytes) -> str:
    """The name of the error with which the package refuses a container, or an empty text."""
    try:
        with TouchReader(io.BytesIO(data)) as reader:
            for i in range(reader.object_count):
                reader.read_object(i)
            for i in range(len(reader.segments)):
                reader.read_segment(i), reader.read_vibration(i)
            _ = reader.provenance
    except FormatError as error:
        return type(error).__name__
    return ""


def error_of_reference_decoder(data: bytes) -> str:
    """The same for the reference decoder."""
    try:
        decoder.read_file(data)
    except reading.FaultyFile as error:
        return type(error).__name__
    return ""


# -- vibrations --------------------------------------------------------------------------------------------


def vibration_cases() -> Iterator[Case]:
    """Amplitudes 0 to 159 and whole hertz 1 to 10000, in the first and last sample and frame."""
    positions = np.array([[0, 0, 0], [4, 4, 4], [8, 7, 9]], np.int32)
    for row, low, high in ((1, 0, 159), (2, 1, 10000)):
        for value, is_right in ((low, True), (high, True), (low - 1, False), (high + 1, False)):
            for frame, sample in ((0, 0), (0, 2), (1, 0), (1, 2)):
                frames = []
                for i in range(2):
                    numbers = [positions, np.full(3, 9, np.int32), np.full(3, 99, np.int32)]
                    if i == frame:
                        numbers[row][sample] = value
                    frames.append((numbers[0], numbers[1], numbers[2]))
                quantity = "amplitude" if row == 1 else "hertz"
                data = voxels(vibration_body(GRID, frames), frames=2)
                yield Case(f"{quantity} {value}, frame {frame}, sample {sample}", data, is_right)


# -- bodies ------------------------------------------------------------------------------------------------

BODY_GRID = Grid((4, 3, 3), (0.01,) * 3, (0.0,) * 3)
SCENE = HapticScene(
    Grid((5, 4, 3), (0.01,) * 3, (0.0,) * 3),
    1000.0,
    (HapticObject("one", HapticMedium.from_frames([ball(BODY_GRID, 0.03)], 1000.0), PoseTrack.constant(3)),),
    1.25,
    0.0,
    "x east, y north, z up",
)
STEPS = (-20, -20)
UNIT = 1 << 20


@cache
def body_records() -> tuple[tuple[str, bytes], ...]:
    """Records of a file of one rigid body."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "body.touch"
        make_golden.write_scene(path, SCENE, TouchSpec(effort="fast"))
        return tuple(split(path.read_bytes()))


def body_file(
    poses: bytes | None = None, max_error: tuple[int, ...] = (0,), parameters: bytes | None = None,
    steps: tuple[int, int] = STEPS,
) -> bytes:  # fmt: skip
    """A file of one rigid body, with some of its numbers replaced."""
    records = dict(body_records())
    numbers = [[0, 0, 0, UNIT, 0, 0, 0]] * 3
    encoded_poses = coded_poses(numbers, [0] * 7) if poses is None else poses
    values = values_of("OBJT", records["OBJT"])
    row_names = [row.name for row in rows_of(RECORD_OF["OBJT"].kind.layout)]
    values[row_names.index("pose_steps")] = struct.pack("bb", *steps)
    rows = rows_of(RECORD_OF["OBJT"].kind.layout)
    records["OBJT"] = b"".join(row.kind.encode(value, "") for row, value in zip(rows, values, strict=True))
    records["SEGM"] = records["SEGM"][:6] + b"".join(map(write_varint, max_error)) + chunk(encoded_poses)
    if parameters is not None:
        head = values_of("HEAD", records["HEAD"])
        head_rows = rows_of(Head)
        head[[row.name for row in head_rows].index("coder_parameters")] = parameters
        records["HEAD"] = b"".join(
            row.kind.encode(value, "") for row, value in zip(head_rows, head, strict=True)
        )
    return joined(list(records.items()))


def body_cases() -> Iterator[Case]:
    """Numbers of the coder `objects` at and beyond their limits."""
    identity_pose = [0, 0, 0, UNIT, 0, 0, 0]
    limit = 1 << 50
    for c, value, is_right in (
        (0, limit, True), (0, limit + 1, False), (2, -limit, True), (2, -limit - 1, False),
        (1, 1 << 60, False),
        (3, UNIT, True), (3, -UNIT, True), (3, UNIT - 1, True), (3, UNIT - 2, False),
        (3, UNIT + 1, False),
        (4, 1448, True), (4, 1449, False),  # (2^20)^2 + 1448^2 < (2^20 + 1)^2 < (2^20)^2 + 1449^2
    ):  # fmt: skip
        for frame in (0, 2):
            numbers = [[*identity_pose] for _ in range(3)]
            numbers[frame][c] = value
            orders = [int(n == c) if frame else 0 for n in range(7)]
            if not frame:
                numbers = [numbers[0]] * 3
            name = f"pose number {c} of {value}, frame {frame}"
            yield Case(name, body_file(coded_poses(numbers, orders)), is_right)
    for order, is_right in ((3, True), (4, False), (-1, False)):
        coded = coded_poses([identity_pose] * 3, [0, 0, 0, 0, 0, 0, order])
        yield Case(f"order {order}", body_file(coded), is_right)
    for steps, is_right in (
        ((-40, -20), True), ((-41, -20), False), ((0, -20), True), ((1, -20), False), ((-20, -31), False),
        ((-20, -1), False),
    ):  # fmt: skip
        yield Case(f"steps {steps}", body_file(steps=steps), is_right)
    for power in (-30, -2):
        coded = coded_poses([[0, 0, 0, 1 << -power, 0, 0, 0]] * 3, [0] * 7)
        yield Case(f"turn {power}", body_file(coded, steps=(-20, power)), is_right=True)
    last = (1 << 20) - 1
    for max_error, is_right in (
        ((1, 0, 0, 0, 0), True), ((65536, 2, last, last, last), True), ((65537, 0, 0, 0, 0), False),
        ((9, 3, 0, 0, 0), False), ((9, 0, last + 1, 0, 0), False), ((9, 0, 0, 0, last + 1), False),
    ):  # fmt: skip
        yield Case(f"worst {max_error}", body_file(max_error=max_error), is_right)
    largest = float(np.finfo(np.float64).max)
    for count, damping, place_tolerance_m, is_right in (
        (1, 0.0, 0.0, True), (1, 1e30, largest, True), (0, 0.0, 0.0, False), (2, 0.0, 0.0, False),
        (1, -5e-324, 0.0, False), (1, float("inf"), 0.0, False), (1, float("nan"), 0.0, False),
        (1, 0.0, -5e-324, False), (1, 0.0, float("inf"), False), (1, 0.0, float("nan"), False),
    ):  # fmt: skip
        data = body_file(parameters=struct.pack("<Idd", count, damping, place_tolerance_m))
        yield Case(f"parameters {count}, {damping}, {place_tolerance_m}", data, is_right)
    valid = layout.Parameters(1, 0.0, 0.0).to_bytes()
    yield Case("parameters short", body_file(parameters=valid[:-1]), is_right=False)
    yield Case("parameters long", body_file(parameters=valid + b"\0"), is_right=False)


def errors_of_decoders(program: Path, path: Path) -> list[str]:
    """The errors of the package, the reference decoder and C when a file is fully decoded."""
    errors = ["", ""]
    try:
        with open_file(path) as opened:
            for i in range(len(opened.medium)):
                opened.medium[i].to_dense()
                if opened.medium.vibration is not None:
                    opened.medium.vibration(i)
            opened.summary()
    except FormatError as error:
        errors[0] = type(error).__name__
    try:
        decoder.decode(path)
    except reading.FaultyFile as error:
        errors[1] = type(error).__name__
    return [*errors, CODES[run(program, path, path.with_suffix(".raw"))[0]]]


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built(tmp_path_factory.mktemp("c"), "touch_decode", "-O1")


@pytest.mark.parametrize("kind", ["vibration", "bodies"])
def test_decoders_have_the_same_limits(kind: str, program: Path, tmp_path: Path) -> None:
    cases = list(vibration_cases() if kind == "vibration" else body_cases())
    wrong = []
    for case in cases:
        path = tmp_path / "case.touch"
        path.write_bytes(case.data)
        found, expected = errors_of_decoders(program, path), "" if case.is_right else "CorruptFile"
        if found != [expected] * 3:
            wrong.append(f"{case.name}: {found}, expected {expected!r}")
    assert len(cases) > 20 and not wrong, "\n".join(wrong)
