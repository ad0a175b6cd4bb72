"""Builds what a release publishes, and checks it: python build_backend/release.py FOLDER [--rehearsal]

FOLDER gets the wheels of all platforms and the source distribution, archives of the site, of the conformance
files and of what is in C (`archives`), and SHA256SUMS. Nothing is uploaded. The checks, in this order:

- the tools are installed, the places that state the version agree, and what is built is a commit whose
  changelog has no section of unreleased changes (a rehearsal reports this, and goes on);
- abi3audit and auditwheel accept the wheels (`wheels`), and twine the descriptions;
- packages contain what the repository has, and nothing else (`packages`);
- the wheel of this platform and the source distribution are each installed in an empty environment, where
  the program decodes a golden file to the stored field, plays it and writes its page; the wheels of other
  platforms are not run;
- the unpacked archives decode the golden file, too;
- files and commit are still those at the start.

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
from functools import partial
from pathlib import Path

from archives import CONTENTS, check_archives, write_archive, write_contents
from compiler import ROOT
from packages import sdist_faults, wheel_faults
from packaging.tags import sys_tags
from packaging.utils import parse_wheel_filename
from wheels import TOOLS, Task, main_of_command, missing_tools, run, run_all, wheel_tasks

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


FOR_SERVERS = {"404.html", "sitemap.xml", "sitemap.xml.gz"}
"""Files of the site with which only a server at a known address can do something."""


def git_output(root: Path, *arguments: str) -> str:
    """Return what git prints; nothing if it fails."""
    done = subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, check=False)
    return done.stdout.rstrip()


def version() -> str:
    """Return the version of the package."""
    text = (ROOT / "src" / "touchfield" / "_version.py").read_text()
    found = re.search(r'^__version__ = "(.+)"$', text, re.MULTILINE)
    assert found is not None
    return found[1]


def version_faults(root: Path, released: str) -> list[str]:
    """Return a line for each place below `root` that does not state the version `released`, or its date."""
    date = "YYYY-MM-DD"
    changelog = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    if dated := re.search(rf"^## {re.escape(released)} - (\d{{4}}-\d\d-\d\d)$", changelog, re.MULTILINE):
        date = dated[1]
    places = [
        ("CITATION.cff", f"version: {released}"),
        ("CITATION.cff", f"date-released: {date}"),
        ("docs/stability.md", f"touchfield is at version {released}."),
        ("CHANGELOG.md", f"## {released} - {date}"),
    ]
    return [
        f'{name}: found no line "{line}"; expected it for the version in src/touchfield/_version.py. '
        "`make version` writes the version in all files; correct the one that is wrong"
        for name, line in places
        if not re.search(
            rf"^{re.escape(line)}(?!\S)", (root / name).read_text(encoding="utf-8"), re.MULTILINE
        )
    ]


def publication_faults(root: Path, released: str) -> list[str]:
    """Return a line for each reason not to publish what is built in `root` as version `released`."""
    faults = []
    if re.search(r"^## Unreleased$", (root / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE):
        faults.append(
            f"CHANGELOG.md: found the section Unreleased; expected {released} to have all changes. "
            "Run `make version VERSION=X.Y.Z`"
        )
    if changed := git_output(root, "status", "--porcelain"):
        faults.append(f"found files that differ from the commit; expected none. Commit or remove:\n{changed}")
    tagged = git_output(root, "rev-parse", "--quiet", "--verify", f"refs/tags/v{released}^{{commit}}")
    if tagged and tagged != git_output(root, "rev-parse", "HEAD"):
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


def write_site(path: Path, released: str) -> None:
    """Write the archive of the site, unless it is there: pages that a browser opens without a server."""
    if path.exists():
        return
    with tempfile.TemporaryDirectory() as site:
        command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", site]
        run(command, SITE_DIRECTORY_URLS="false", SITE_VERSION=f"touchfield {released}")
        files = [file for file in Path(site).rglob("*") if file.is_file() and file.name not in FOR_SERVERS]
        write_archive(path, files, Path(site))


def write_sums(folder: Path) -> None:
    """Write SHA256SUMS of the files in `folder`, as ``sha256sum --check`` reads it."""
    files = sorted(path for path in folder.iterdir() if path.name not in ("SHA256SUMS", COMMIT))
    lines = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in files]
    (folder / "SHA256SUMS").write_text("".join(lines))


def build(folder: Path, released: str) -> None:
    """Build all files into `folder`, as many at a time as there are cores."""
    remove_parts(folder)
    tasks: list[Task] = [
        *wheel_tasks(folder),
        partial(write_site, folder / f"touchfield-site-{released}.zip", released),
        partial(build_sdist, folder),
        *(partial(write_contents, folder, name, released) for name in CONTENTS),
    ]
    run_all(tasks)


def repository_state(root: Path) -> tuple[str, str]:
    """Return the commit of `root`, and git's list of the files that differ from it.

    Ends the program if `root` is no repository with a commit: packages are compared with what git tracks.
    """
    commit = git_output(root, "rev-parse", "--verify", "HEAD")
    if not commit:
        sys.exit(f"{root}: found no commit that git can read; expected a clone of the repository")
    return commit, git_output(root, "status", "--porcelain")


def check_unchanged(root: Path, state: tuple[str, str]) -> None:
    """End the program if `root` is no longer in `state`: packages may be of two states."""
    if repository_state(root) != state:
        sys.exit(
            f"{root}: found changes that were made during the build; expected none. Empty the folder of the "
            "release, and start again"
        )


def main(folder: Path, is_rehearsal: bool = False) -> None:
    """Build and check a release into `folder`, which must be empty, missing, or incomplete."""
    released = version()
    state = commit, changed = repository_state(ROOT)
    unfit = publication_faults(ROOT, released)
    tools = missing_tools((*TOOLS, "build", "mkdocs", "mkdocstrings", "twine"), "release")
    if faults := [*tools, *version_faults(ROOT, released), *([] if is_rehearsal else unfit)]:
        sys.exit("\n".join(faults))
    prepare_folder(folder, "" if changed else commit)
    build(folder, released)
    check_packages(folder)
    packages = wheel_for_this_platform(folder), next(folder.glob("*.tar.gz"))
    installs = [partial(check_install, package, released) for package in packages]
    run_all([*installs, partial(check_archives, folder, released)])
    check_unchanged(ROOT, state)
    write_sums(folder)
    (folder / COMMIT).unlink()
    print(f"touchfield {released}: {len(list(folder.iterdir()))} files in {folder}")
    print("\n".join(["a rehearsal, not to be published:", *unfit]) if unfit else "ready to be published")


if __name__ == "__main__":
    main_of_command(lambda: main(Path(sys.argv[1]).resolve(), "--rehearsal" in sys.argv[2:]))
