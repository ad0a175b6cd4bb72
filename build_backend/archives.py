"""Writes and tries the archives of a release: the conformance files, and what is in C.

An archive is complete by itself: it has the licence and the format's pages, and no page links to a file that
it does not have.
"""

from __future__ import annotations

import posixpath
import re
import sys
import tempfile
import zipfile
from collections.abc import Collection, Iterable
from pathlib import Path, PurePosixPath

from compiler import ROOT, find_compiler
from packages import tracked_files
from wheels import run

CONTENTS = {
    "conformance": ("conformance", "docs/format", "tests/conformance/ticks.c"),
    "c": ("c", "docs/format", "integrations"),
}
"""Files and folders of the repository in each archive."""

_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\((?!https?://|#)([^)\s]+)\)")

COMPARE = """
import sys
import numpy as np

decoded, expected = (np.load(path)["forces_n"] for path in sys.argv[1:])
if not np.array_equal(decoded, expected):
    sys.exit(f"{sys.argv[1]}: found another field than {sys.argv[2]}")
"""
"""Program that compares the fields of two files."""


def archive_path(folder: Path, name: str, released: str) -> Path:
    """Return the path of the archive `name` of `CONTENTS`."""
    return folder / f"touchfield-{name}-{released}.zip"


def write_archive(path: Path, files: Iterable[Path], root: Path) -> None:
    """Write files, by their paths below `root`, in a zip archive with one folder of the archive's name.

    Pages (``.md``) lose links to files that the archive does not have, and keep their texts. Times are
    constant, so that equal files make equal archives. The archive appears once it is complete.
    """
    contents = {file.relative_to(root).as_posix(): file for file in files}
    part = path.with_name(f".{path.name}.part")
    with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, file in sorted(contents.items()):
            data = file.read_bytes()
            if file.suffix == ".md":
                data = page_in_archive(data.decode(), name, contents).encode()
            archive.writestr(zipfile.ZipInfo(f"{path.stem}/{name}"), data, zipfile.ZIP_DEFLATED)
    part.replace(path)


def page_in_archive(text: str, name: str, names: Collection[str]) -> str:
    """Return the Markdown of the page `name`, with the texts of links to files that are not in `names`."""
    known = {*names} | {folder.as_posix() for path in names for folder in PurePosixPath(path).parents}

    def link_or_text(link: re.Match[str]) -> str:
        target = posixpath.join(posixpath.dirname(name), link[2].partition("#")[0])
        return link[0] if posixpath.normpath(target) in known else link[1]

    return _LINK.sub(link_or_text, text)


def write_contents(folder: Path, name: str, released: str) -> None:
    """Write the archive `name` of `CONTENTS` into `folder`."""
    write_archive(archive_path(folder, name, released), tracked_files(*CONTENTS[name]), ROOT)


def check_archives(folder: Path, released: str) -> None:
    """Unpack the archives of `folder`; decode a golden file with their decoders in Python and in C."""
    with tempfile.TemporaryDirectory() as unpacked:
        for name in CONTENTS:
            with zipfile.ZipFile(archive_path(folder, name, released)) as archive:
                archive.extractall(unpacked)
        conformance = Path(unpacked, f"touchfield-conformance-{released}", "conformance")
        golden, decoded = conformance / "v1" / "touch-block.touch", Path(unpacked, "decoded.npz")
        run([sys.executable, conformance / "decoder.py", golden, decoded], cwd=unpacked)
        run([sys.executable, "-c", COMPARE, decoded, golden.with_suffix(".npz")], cwd=unpacked)
        sources = Path(unpacked, f"touchfield-c-{released}", "c")
        for program in ("touch_decode", "touch_write"):
            command = [*find_compiler(), "-std=c99", sources / f"{program}.c", "-o", program, "-lm"]
            run(command, cwd=unpacked)
        run([Path(unpacked, "touch_decode"), golden, "decoded.bin"], cwd=unpacked)
