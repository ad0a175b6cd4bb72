"""Every faulty file is refused by both decoders, with the error that errors.json names."""

from __future__ import annotations

import importlib
import io
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from second import CONFORMANCE, FAULTY, GOLDEN, decoder, reading

from touchfield import errors
from touchfield.container import TouchReader
from touchfield.pipeline.decoding import open_file, stream_of

FOLDER = CONFORMANCE / "faulty"


def test_errors_json_lists_the_folder() -> None:
    assert {path.stem for path in FOLDER.glob("*.touch")} == FAULTY.keys()


@pytest.mark.thorough
def test_stored_files_are_those_of_the_generator(tmp_path: Path) -> None:
    faults: Any = importlib.import_module("make_faulty")
    for path in FOLDER.glob("older-*"):
        shutil.copy(path, tmp_path)
    (tmp_path / "stale.touch").write_bytes(b"")
    faults.write_faulty(GOLDEN[0].parent, tmp_path)
    generated, stored = (
        {path.name: path.read_bytes() for path in folder.iterdir()} for folder in (tmp_path, FOLDER)
    )
    assert generated == stored


@pytest.mark.parametrize("name", FAULTY)
def test_package_refuses_the_file(name: str) -> None:
    kind = getattr(errors, FAULTY[name])
    with pytest.raises(kind) as caught, open_file(FOLDER / f"{name}.touch") as stream:  # noqa: PT012
        for i, frame in enumerate(stream.medium):
            frame.to_dense()
            if stream.medium.vibration is not None:
                stream.medium.vibration(i)
    assert type(caught.value) is kind and "\n" not in str(caught.value)
    assert caught.value.where.startswith(str(FOLDER / f"{name}.touch")), "every refusal names the file"


def test_a_summary_that_is_refused_names_the_file() -> None:
    refused: dict[str, str] = {}
    for name in FAULTY:
        try:
            with open_file(FOLDER / f"{name}.touch") as stream:
                stream.summary()
        except errors.FormatError as error:
            refused[name] = error.where
    assert len(refused) > len(FAULTY) / 2
    assert all(where.startswith(str(FOLDER / f"{name}.touch")) for name, where in refused.items()), refused


@pytest.mark.parametrize("name", FAULTY)
def test_reference_decoder_refuses_the_file(name: str) -> None:
    with pytest.raises(reading.FaultyFile) as caught:
        decoder.decode(FOLDER / f"{name}.touch")
    assert type(caught.value).__name__ == FAULTY[name], str(caught.value)


@pytest.mark.parametrize(
    ("tag", "offset_from_end", "code", "value"),
    [
        ("HEAD", 20, "I", 2), ("HEAD", 20, "I", 4), ("HEAD", 16, "d", -1.0), ("HEAD", 16, "d", float("nan")),
        ("HEAD", 8, "d", -1e-9), ("HEAD", 8, "d", float("inf")),
        ("OBJT", 0, "b", -41), ("OBJT", 0, "b", 1), ("OBJT", -1, "b", -31), ("OBJT", -1, "b", -1),
        ("OBJT", -2, "b", 0),
    ],
)  # fmt: skip
def test_both_refuse_bounds_of_objects(tag: str, offset_from_end: int, code: str, value: float) -> None:
    """Out-of-range parameters of HEAD or pose steps of a deforming body, or an unexpected field."""
    faults: Any = importlib.import_module("make_faulty")
    records = faults.records_of((CONFORMANCE / "v1" / "objects-deforming.touch").read_bytes())
    at = max(i for i, record in enumerate(records) if record.tag == tag.encode())
    offset = len(records[at].payload) - (offset_from_end if tag == "HEAD" else 2 + offset_from_end)
    records[at] = records[at].changed(offset, code, value)
    data = faults.assembled(records)
    with pytest.raises(errors.CorruptFile), TouchReader(io.BytesIO(data)) as reader:
        next(iter(stream_of(reader).medium))
    with pytest.raises(reading.CorruptFile):
        next(decoder.frames_of(decoder.read_file(data)))


@pytest.mark.parametrize("name", [name for name in FAULTY if name.startswith("older")])
def test_error_of_older_files_suggests_encoding_again(name: str) -> None:
    for program in (
        [sys.executable, "-m", "touchfield", "info"],
        [sys.executable, CONFORMANCE / "decoder.py"],
    ):
        output_arguments = [] if program[-1] == "info" else ["out.npz"]
        command = [*program, FOLDER / f"{name}.touch", *output_arguments]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        assert done.returncode == 1 and "Traceback" not in done.stderr
        assert "made by a version before 1.0" in done.stderr and "ncode it again" in done.stderr


def test_grid_beyond_the_limits_allocates_nothing() -> None:
    code = """if True:
        import resource, sys
        from touchfield.pipeline.decoding import open_file
        resource.setrlimit(resource.RLIMIT_DATA, (1 << 30, 1 << 30))
        from touchfield.errors import CorruptFile
        for path in sys.argv[1:]:
            try:
                list(open_file(path).__enter__().medium)
            except CorruptFile as error:
                print(path, error)
    """
    files = [str(FOLDER / f"{name}.touch") for name in FAULTY if "too-" in name]
    done = subprocess.run([sys.executable, "-c", code, *files], capture_output=True, text=True, timeout=120)
    refused_paths = [line.partition(" ")[0] for line in done.stdout.splitlines() if "grid_shape" in line]
    assert done.returncode == 0 and len(files) > 2 and refused_paths == files, done.stdout + done.stderr
