"""Reads a valid file by readers that misbehave, as `bench/parser_worker.py` would; prints what it judges.

It runs in a process of its own: the worker changes the folder of temporary files and watches what is opened.
"""

from __future__ import annotations

import json
import os
import random
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "bench"))
from parser_formats import Format, file_of
from parser_worker import Bench, TooLong
from touchfield.errors import InvalidArgument, SourceError


def unchanged(data: bytes, rng: random.Random) -> bytes:
    return data


def refuse(path: Path) -> None:
    raise SourceError(str(path), "nothing", "something")


def refuse_without_name(path: Path) -> None:
    raise SourceError("it", "nothing", "something")


def refuse_an_option(path: Path) -> None:
    raise InvalidArgument("--nw", "0", "1 or more")


def leave_a_file(path: Path) -> None:
    Path("out.touch").write_text("partial")
    refuse(path)


def open_outside(path: Path) -> None:
    path.parent.joinpath("../../../elsewhere").resolve().write_text("")


def read_by_c(path: Path) -> None:
    """Read a file as a library in C does, which no audit event reports."""
    os.utime((path.parent / "../../../outside/secret").resolve(), ns=(10**18, 10**18))


def warn(path: Path) -> None:
    warnings.warn("overflow", RuntimeWarning, stacklevel=1)


def take_memory(path: Path) -> None:
    bytearray(400 << 20)


def hang(path: Path) -> None:
    raise TooLong("interrupted")


READERS = {
    "read": lambda path: path.read_bytes(),
    "refused": refuse,
    "refused option": refuse_an_option,
    **{
        f"FAULT {reader.__name__}": reader
        for reader in (refuse_without_name, leave_a_file, open_outside, read_by_c, warn, take_memory, hang)
    },
    "FAULT key": lambda path: {}[path],
}


def main() -> None:
    with tempfile.TemporaryDirectory() as root:
        bench, judged = Bench(Path(root).resolve()), dict[str, str]()
        for name, reader in READERS.items():

            def read(path: Path, out: Path, options: dict[str, Any], reader: Any = reader) -> None:
                reader(path)

            outcome = bench.run(Format(name, read, (file_of("a.txt", "valid"),), mutate=unchanged), 0, 0)
            judged[name] = f"{outcome.kind} {outcome.text}"
        os.chdir("/")
    print(json.dumps(judged))


if __name__ == "__main__":
    main()
