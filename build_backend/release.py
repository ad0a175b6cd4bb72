"""Builds what a release publishes, and checks it: python build_backend/release.py FOLDER [--rehearsal]

FOLDER gets the wheels of all platforms and the source distribution, the site, the conformance files and the
headers in C as archives, and SHA256SUMS. Nothing is uploaded. The checks, in this order:

- the tools are installed, the places that state the version agree, and what is built is a commit whose
  changelog has no section of unreleased changes (a rehearsal reports this, and goes on);
- abi3audit and auditwheel accept the wheels (`wheels`), and twine the descriptions;
- packages contain what the repository has, and nothing else (`packages`);
- the wheel of this platform and the source distribution are each installed in an empty environment, where
  the program decodes a golden file to the stored field, plays it and writes its page.

What was built stays if a run is interrupted: the next run of the same commit goes on from there.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import venv
import zipfile
from collections.abc import Iterable
from functools import partial
from pathlib import Path

from compiler import ROOT
from packages import sdist_faults, tracked_files, wheel_faults
from packaging.tags import sys_tags
from packaging.utils import parse_wheel_filename
from wheels import TOOLS, Task, missing_tools, run, run_all, wheel_tasks

GOLDEN = ROOT / "conformance" / "v1" / "touch-block.touch"
"""The golden file that an installed package decodes."""

COMMIT = ".commit"
"""File that states of which commit an incomplete folder is."""

DECODE = """
import sys
import numpy as np
import touchfield

stream, expected, version = sys.argv[1:]
if touchfield.__version__ != version:
    sys.exit(f"found touchfield {touchfield.__version__}; expected {version}")
with touchfield.open_stream(stream) as opened, np.load(expected) as file:
    for number, forces_n in enumerate(file["forces_n"]):
        if not np.array_equal(opened.medium[number].to_dense(), forces_n):
            sys.exit(f"{stream}: frame {number} is decoded to another field than the stored")
print("touchfield", touchfield.__version__, "decodes", stream)
"""
"""Program that compares a stream with its stored field; arguments are the two files and the version."""

USES = (
    ("--help",),
    ("info", GOLDEN),
    ("decode", GOLDEN, "decoded.npz"),
    ("play", GOLDEN, "--offline"),
    ("view", GOLDEN, "--out", "page.html", "--no-open"),
)
"""What a receiver does, as arguments of the program."""


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
        f"{name}: found no line for version {released}; expected one that matches {pattern}. "
        "Run `make version VERSION=X.Y.Z`"
        for name, pattern in places.items()
        if not re.search(pattern, (root / name).read_text(encoding="utf-8"), re.MULTILINE)
    ]


def publication_faults(root: Path, released: str) -> list[str]:
    """Return a line for each reason not to publish what is built in `root` as version `released`."""
    faults = []
    if re.search(r"^## Unreleased$", (root / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE):
        faults.append(
            f"CHANGELOG.md: found the section Unreleased; expected {released} to have all changes. "
            "Run `make version VERSION=X.Y.Z`"
        )
    if changed := _git(root, "status", "--porcelain"):
        faults.append(f"found files that differ from the commit; expected none. Commit or remove:\n{changed}")
    tagged = _git(root, "rev-parse", "--quiet", "--verify", f"refs/tags/v{released}^{{commit}}")
    if tagged and tagged != _git(root, "rev-parse", "HEAD"):
        faults.append(
            f"the tag v{released} is at commit {tagged}; expected it here, or a version without a tag"
        )
    return faults


def prepare_folder(folder: Path, commit: str) -> None:
    """Make sure that `folder` is empty, or has an incomplete release of `commit`.

    An empty `commit` stands for files that are those of no commit.
    """
    folder.mkdir(parents=True, exist_ok=True)
    stamp = folder / COMMIT
    if commit and stamp.exists() and stamp.read_text() == commit:
        print(f"{folder}: found a part of this release; what is there is not built again", flush=True)
        return
    if any(folder.iterdir()):
        sys.exit(
            f"{folder}: found files; expected an empty folder. Remove them: they may be of another version"
        )
    stamp.write_text(commit)


def remove_parts(folder: Path) -> None:
    """Remove what an interrupted run has left incomplete in `folder`."""
    for part in folder.glob(".*.part"):
        part.unlink()
    for unchecked in folder.glob(".wheel-*"):
        shutil.rmtree(unchecked)


def build_sdist(folder: Path) -> None:
    """Build the source distribution into `folder`."""
    run([sys.executable, "-m", "build", "--sdist", "--no-isolation", "--outdir", folder, ROOT])


def check_packages(folder: Path) -> None:
    """Check the descriptions and the contents of the packages in `folder`."""
    built = sorted(folder.glob("*.whl"))
    sources = list(folder.glob("*.tar.gz"))
    run([sys.executable, "-m", "twine", "check", "--strict", *built, *sources])
    faults = [fault for wheel in built for fault in wheel_faults(wheel)]
    faults += [fault for sdist in sources for fault in sdist_faults(sdist)]
    if faults:
        sys.exit("\n".join(faults))


def wheel_for_this_platform(folder: Path) -> Path:
    """Return the wheel in `folder` that pip would take here."""
    accepted = set(sys_tags())
    found = [path for path in folder.glob("*.whl") if parse_wheel_filename(path.name)[3] & accepted]
    if not found:
        sys.exit(f"{folder}: found no wheel for this platform; expected one, to install and try it")
    return found[0]


def check_install(package: Path, released: str) -> None:
    """Install a package in an empty environment; decode a golden file there, play it and write its page."""
    with tempfile.TemporaryDirectory() as folder:
        venv.create(folder, with_pip=True)
        python = Path(folder, "Scripts/python.exe" if os.name == "nt" else "bin/python")
        run([python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", package])
        run([python, "-c", DECODE, GOLDEN, GOLDEN.with_suffix(".npz"), released], cwd=folder)
        for arguments in USES:
            run([python.with_stem("touchfield"), *arguments], cwd=folder)


def write_archive(path: Path, files: Iterable[Path], root: Path) -> None:
    """Write files, by their paths below `root`, in a zip archive with one folder of the archive's name.

    Times are constant, so that equal files make equal archives. The archive appears once it is complete.
    """
    part = path.with_name(f".{path.name}.part")
    with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(files):
            name = f"{path.stem}/{file.relative_to(root).as_posix()}"
            archive.writestr(zipfile.ZipInfo(name), file.read_bytes(), zipfile.ZIP_DEFLATED)
    part.replace(path)


def write_site(path: Path, released: str) -> None:
    """Write the archive of the site, unless it is there: pages that a browser opens without a server."""
    if path.exists():
        return
    with tempfile.TemporaryDirectory() as site:
        command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", site]
        run(command, SITE_DIRECTORY_URLS="false", SITE_VERSION=f"touchfield {released}")
        files = [file for file in Path(site).rglob("*") if file.is_file()]
        write_archive(path, files, Path(site))


def write_sums(folder: Path) -> None:
    """Write SHA256SUMS of the files in `folder`, as ``sha256sum --check`` reads it."""
    files = sorted(path for path in folder.iterdir() if path.name not in ("SHA256SUMS", COMMIT))
    lines = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in files]
    (folder / "SHA256SUMS").write_text("".join(lines))


def build(folder: Path, released: str) -> None:
    """Build all files into `folder`, as many at a time as there are cores."""
    remove_parts(folder)
    conformance = folder / f"touchfield-conformance-{released}.zip"
    headers = folder / f"touchfield-c-{released}.zip"
    tasks: list[Task] = [
        *wheel_tasks(folder),
        partial(write_site, folder / f"touchfield-site-{released}.zip", released),
        partial(build_sdist, folder),
        partial(write_archive, conformance, tracked_files("conformance"), ROOT),
        partial(write_archive, headers, tracked_files("c", "docs/format"), ROOT),
    ]
    run_all(tasks)


def main(folder: Path, is_rehearsal: bool = False) -> None:
    """Build and check a release into `folder`, which must be empty, missing, or incomplete."""
    released = version()
    unfit = publication_faults(ROOT, released)
    tools = missing_tools((*TOOLS, "build", "mkdocs", "mkdocstrings", "twine"), "release")
    if faults := [*tools, *version_faults(ROOT, released), *([] if is_rehearsal else unfit)]:
        sys.exit("\n".join(faults))
    is_commit = not _git(ROOT, "status", "--porcelain")
    prepare_folder(folder, _git(ROOT, "rev-parse", "HEAD") if is_commit else "")
    build(folder, released)
    check_packages(folder)
    packages = wheel_for_this_platform(folder), next(folder.glob("*.tar.gz"))
    run_all(partial(check_install, package, released) for package in packages)
    write_sums(folder)
    (folder / COMMIT).unlink()
    print(f"touchfield {released}: {len(list(folder.iterdir()))} files in {folder}")
    print("\n".join(["a rehearsal, not to be published:", *unfit]) if unfit else "ready to be published")


def _git(root: Path, *arguments: str) -> str:
    """Return what git prints; nothing if it fails."""
    done = subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, check=False)
    return done.stdout.strip()


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]).resolve(), "--rehearsal" in sys.argv[2:])
    except subprocess.CalledProcessError as error:
        sys.exit(
            f"{error.cmd[0]}: failed with status {error.returncode}; nothing is released, its output is above"
        )
