"""Builds what a release publishes, and checks it: python build_backend/release.py FOLDER

FOLDER gets the wheels of all platforms and the source distribution, the site, the conformance files and the
headers in C as archives, and SHA256SUMS. Nothing is uploaded. The checks, in this order:

- the places that state the version agree, and the changelog has a section of it;
- abi3audit and auditwheel accept the wheels (`wheels`), and twine the descriptions;
- the wheel of this platform and the source distribution are each installed in an empty environment, where
  the program decodes a golden file to the stored field.
"""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
import tempfile
import venv
import zipfile
from collections.abc import Iterable
from pathlib import Path

import wheels
from compiler import ROOT
from packaging.tags import sys_tags
from packaging.utils import parse_wheel_filename

GOLDEN = ROOT / "conformance" / "v1" / "touch-block.touch"
"""The golden file that an installed package decodes."""

DECODE = """
import sys
import numpy as np
import touchfield

stream, expected = sys.argv[1:]
with touchfield.open_stream(stream) as opened, np.load(expected) as file:
    for number, forces_n in enumerate(file["forces_n"]):
        if not np.array_equal(opened.medium[number].to_dense(), forces_n):
            sys.exit(f"{stream}: frame {number} is decoded to another field than the stored")
print("touchfield", touchfield.__version__, "decodes", stream)
"""
"""Program that compares a stream with its stored field; arguments are the two files."""


def version() -> str:
    """Return the version of the package."""
    text = (ROOT / "src" / "touchfield" / "_version.py").read_text()
    found = re.search(r'^__version__ = "(.+)"$', text, re.MULTILINE)
    assert found is not None
    return found[1]


def version_faults(root: Path, released: str) -> list[str]:
    """Return a line for each place below `root` that states another version than `released`."""
    number = re.escape(released)
    places = {
        "CITATION.cff": rf"^version: {number}$",
        "docs/stability.md": rf"^touchfield is at version {number}\.",
        "CHANGELOG.md": rf"^## {number} - \d{{4}}-\d\d-\d\d$",
    }
    return [
        f"{name}: found no line for version {released}; expected one that matches {pattern}"
        for name, pattern in places.items()
        if not re.search(pattern, (root / name).read_text(), re.MULTILINE)
    ]


def build_packages(folder: Path) -> None:
    """Build and check the wheels and the source distribution into `folder`."""
    wheels.main(folder)
    run([sys.executable, "-m", "build", "--sdist", "--no-isolation", "--outdir", folder, ROOT])
    packages = [*folder.glob("*.whl"), *folder.glob("*.tar.gz")]
    run([sys.executable, "-m", "twine", "check", "--strict", *packages])


def wheel_for_this_platform(folder: Path) -> Path:
    """Return the wheel in `folder` that pip would take here."""
    accepted = set(sys_tags())
    found = [path for path in folder.glob("*.whl") if parse_wheel_filename(path.name)[3] & accepted]
    if not found:
        sys.exit(f"{folder}: found no wheel for this platform; expected one, to install and try it")
    return found[0]


def check_install(package: Path) -> None:
    """Install a package in an empty environment, and decode a golden file there."""
    with tempfile.TemporaryDirectory() as folder:
        venv.create(folder, with_pip=True)
        python = Path(folder, "Scripts/python.exe" if os.name == "nt" else "bin/python")
        run([python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", package])
        run([python, "-c", DECODE, GOLDEN, GOLDEN.with_suffix(".npz")], cwd=folder)
        run([python, "-m", "touchfield", "info", GOLDEN], cwd=folder)


def write_archive(path: Path, files: Iterable[Path], root: Path) -> None:
    """Write files, by their paths below `root`, in a zip archive with one folder of the archive's name.

    Times are constant, so that equal files make equal archives.
    """
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(files):
            name = f"{path.stem}/{file.relative_to(root).as_posix()}"
            archive.writestr(zipfile.ZipInfo(name), file.read_bytes(), zipfile.ZIP_DEFLATED)


def tracked_files(*folders: str) -> list[Path]:
    """Return the files of the repository below folders, and its licence."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "LICENSE", *folders], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
    return [ROOT / name for name in listed.split("\0") if name]


def write_archives(folder: Path, released: str) -> None:
    """Write the archives of the conformance files, the headers in C, and the site."""
    write_archive(folder / f"touchfield-conformance-{released}.zip", tracked_files("conformance"), ROOT)
    write_archive(folder / f"touchfield-c-{released}.zip", tracked_files("c", "docs/format"), ROOT)
    with tempfile.TemporaryDirectory() as site:
        run([sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", site])
        files = [path for path in Path(site).rglob("*") if path.is_file()]
        write_archive(folder / f"touchfield-site-{released}.zip", files, Path(site))


def write_sums(folder: Path) -> None:
    """Write SHA256SUMS of the files in `folder`, as ``sha256sum --check`` reads it."""
    files = sorted(path for path in folder.iterdir() if path.name != "SHA256SUMS")
    lines = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in files]
    (folder / "SHA256SUMS").write_text("".join(lines))


def run(command: list[str | Path], cwd: str | Path = ROOT) -> None:
    """Run a command; stop the release if it fails."""
    print("+", *(part for part in command if part != DECODE), flush=True)
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    subprocess.run([str(part) for part in command], cwd=cwd, env=environment, check=True)


def main(folder: Path) -> None:
    """Build and check a release into `folder`, which must be empty or missing."""
    released = version()
    if faults := version_faults(ROOT, released):
        sys.exit("\n".join(faults))
    if folder.exists() and any(folder.iterdir()):
        sys.exit(
            f"{folder}: found files; expected an empty folder. Remove them: they may be of another version"
        )
    build_packages(folder)
    check_install(wheel_for_this_platform(folder))
    check_install(next(folder.glob("*.tar.gz")))
    write_archives(folder, released)
    write_sums(folder)
    print(f"touchfield {released}: {len(list(folder.iterdir()))} files in {folder}")


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]).resolve())
    except subprocess.CalledProcessError as error:
        sys.exit(f"{error.cmd[0]}: failed with status {error.returncode}; nothing is released")
