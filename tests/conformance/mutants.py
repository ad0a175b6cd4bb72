"""Mutants of files whose CRC-32s hold, and what each of the three decoders reports for one.

All read VIBR before the frames, as the C code does: a changed HEAD may make both faulty.

``python tests/conformance/mutants.py PROGRAM SEED COUNT [FILE.touch...]`` decodes `COUNT` mutants with
`PROGRAM` (c/touch_decode.c, compiled), the package and the second decoder, and tabulates the differences.
"""

from __future__ import annotations

import importlib
import math
import random
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from second import GOLDEN, decoder, reading
from test_c import CODES, OBJECTS_ATOL_N, Raw, is_paper, run

from touchfield.errors import FormatError, InvalidArgument
from touchfield.pipeline.decoded_objects import SceneStream
from touchfield.pipeline.decoding import open_file

FAULTS: Any = importlib.import_module("make_faulty")
MAX_SAMPLES = 1 << 17  # of a lattice that is laid out; mutants with larger ones are made again
HEAD_BYTES = 48  # most faults that decoders may meet in another order lie among the first bytes


class Outcome(NamedTuple):
    """Kind of the error, "" if there is none; forces and vibrations of all frames, or None."""

    kind: str
    values: Any = None
    message: str = ""


def edited(payload: bytes, at: int, rng: random.Random) -> bytes:
    """A payload with one edit at an index: bits, a byte, or bytes inserted, deleted, or repeated."""
    count = rng.randint(1, 4)
    match rng.randrange(7):
        case 0 | 1:
            return payload[:at] + bytes([payload[at] ^ 1 << rng.randrange(8)]) + payload[at + 1 :]
        case 2:
            return payload[:at] + bytes([rng.choice((0, 1, 127, 128, 255))]) + payload[at + 1 :]
        case 3:
            return payload[:at] + rng.randbytes(count) + payload[at:]
        case 4:
            return payload[:at] + payload[at + count :]
        case 5:
            return payload[:at]
        case _:
            return payload[: at + count] + payload[at:]


def mutant(data: bytes, rng: random.Random) -> bytes:
    """A file with one to three edits in one record; its lengths, CRC-32s, INDX and TEND are mended."""
    records = FAULTS.records_of(data)
    index = rng.choice([i for i, record in enumerate(records) if record.tag != b"PROV"])
    payload = records[index].payload
    for _ in range(rng.randint(1, 3)):
        begin = 6 if records[index].tag in (b"SEGM", b"VIBR") and rng.random() < 0.95 else 0
        end = min(len(payload), begin + HEAD_BYTES) if rng.random() < 0.5 else len(payload)
        payload = edited(payload, rng.randrange(begin, end), rng) if begin < end else payload
    records[index] = records[index]._replace(payload=payload)
    return FAULTS.assembled(records)  # type: ignore[no-any-return]


def is_small(data: bytes) -> bool:
    """Whether the lattices of a file, if it has valid ones, may be laid out."""
    try:
        file = decoder.read_file(data)
    except reading.FaultyFile:
        return True
    shapes = [fields["grid_shape"] for fields in (file.head, *file.objects)]
    return file.head["frame_count"] < 100 and all(math.prod(shape) <= MAX_SAMPLES for shape in shapes)


def by_package(path: Path) -> Outcome:
    """What the package reports."""
    try:
        with open_file(path) as opened:
            for body in opened.scene.objects if isinstance(opened, SceneStream) else ():
                list(body.medium)  # also a body that lies nowhere in the grid
            medium = opened.medium
            vibrations = []
            for i in range(len(medium)) if medium.vibration is not None else ():
                vibration, both = medium.vibration(i), np.zeros((2, *medium.grid.shape), np.float32)
                at = tuple(vibration.positions.T)
                both[(0, *at)], both[(1, *at)] = vibration.amplitudes_n, vibration.frequencies_hz
                vibrations.append(both)
            frames = [np.asarray(frame.to_dense()) for frame in medium]
    except FormatError as error:
        return Outcome(type(error).__name__, message=str(error))
    except InvalidArgument as error:
        return Outcome("InvalidArgument", message=str(error))
    return Outcome("", (frames, vibrations))


def by_reference(data: bytes) -> Outcome:
    """What the second decoder reports."""
    try:
        file = decoder.read_file(data)
        shape = file.head["grid_shape"]
        both = decoder.vibration_of(file)
        frames = [
            reading.laid_out(frame, shape) if isinstance(frame, dict) else frame
            for frame in decoder.frames_of(file)
        ]
    except reading.FaultyFile as error:
        return Outcome(type(error).__name__, message=str(error))
    if not both:
        return Outcome("", (frames, []))
    vibrations = np.stack([both["amplitudes_n"], both["frequencies_hz"]], axis=1)
    return Outcome("", (frames, list(vibrations)))


def by_c(program: Path, path: Path, out: Path) -> Outcome:
    """What `touch_decode` reports; vibrations of all frames, also where there are none."""
    code, message = run(program, path, out)
    if code:
        return Outcome(CODES[code] if 0 < code < len(CODES) else str(code), message=message)
    head = decoder.read_file(path.read_bytes()).head
    raw, frames, vibrations = Raw(out.read_bytes(), head["grid_shape"]), [], []
    for _ in range(head["frame_count"]):
        if head["coder"] == "objects":
            frames.append(raw.numbers("<f4", 3 * math.prod(raw.shape)).reshape(*raw.shape, 3))
        else:
            frames.append(raw.field())
        vibrations.append(np.moveaxis(raw.field()[..., :2], -1, 0))
    return Outcome("", (frames, vibrations))


def difference(c: Outcome, package: Outcome, reference: Outcome) -> str:
    """In what the three outcomes differ, "" if in nothing."""
    kinds = c.kind, package.kind, reference.kind
    if len(set(kinds)) > 1:
        return " / ".join(kind or "accepted" for kind in kinds)
    if c.kind:
        return ""
    for other in (package.values, reference.values):
        for own, theirs in zip(c.values[0], other[0], strict=True):
            if not np.allclose(own, theirs, rtol=1e-5, atol=OBJECTS_ATOL_N):
                return "forces"
        theirs_or_none = other[1] or [np.zeros_like(both) for both in c.values[1]]
        if any((own != theirs).any() for own, theirs in zip(c.values[1], theirs_or_none, strict=True)):
            return "vibrations"
    return ""


def compare(
    program: Path, streams: Sequence[bytes], seed: int, count: int, folder: Path, keep: Path | None = None
) -> tuple[Counter[str], list[str]]:
    """Kinds of the outcomes of so many mutants, and a line for each difference.

    Mutants that differ are written to `keep`.
    """
    rng, kinds, differences = random.Random(seed), Counter[str](), []
    path = folder / "mutant.touch"
    for n in range(count):
        data = mutant(rng.choice(streams), rng)
        while not is_small(data):
            data = mutant(rng.choice(streams), rng)
        path.write_bytes(data)
        outcomes = by_c(program, path, folder / "raw"), by_package(path), by_reference(data)
        kinds[outcomes[0].kind] += 1
        if found := difference(*outcomes):
            differences.append(f"{n}: {found}: " + " | ".join(outcome.message for outcome in outcomes))
            if keep is not None:
                (keep / f"{seed}-{n}.touch").write_bytes(data)
    return kinds, differences


def main() -> None:
    """Tabulate the differences."""
    program, seed, count, *paths = sys.argv[1:]
    streams = [Path(path) for path in paths] or [s for s in GOLDEN if not is_paper(s)]
    with tempfile.TemporaryDirectory() as folder:
        keep = Path(tempfile.mkdtemp(prefix="mutants-"))
        small = [data for path in streams if is_small(data := path.read_bytes())]
        kinds, differences = compare(Path(program), small, int(seed), int(count), Path(folder), keep)
    print(*differences, sep="\n")
    print(dict(kinds), f"{len(differences)} differences, in {keep}")


if __name__ == "__main__":
    main()
