"""Checks what packages contain: the tracked files that they are made from, and nothing else."""

from __future__ import annotations

import re
import subprocess
import tarfile
import tomllib
import zipfile
from pathlib import Path

from compiler import ROOT

_ADDED = {"PKG-INFO", "pyproject.toml", ".gitignore"}
"""What hatchling adds to a source distribution."""

_DIST_INFO = {"METADATA", "WHEEL", "RECORD", "entry_points.txt", "licenses/LICENSE"}


def tracked_files(*folders: str) -> list[Path]:
    """Return the files of the repository below folders, and its licence."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "LICENSE", *folders], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
    return [ROOT / name for name in listed.split("\0") if name]


def wheel_faults(wheel: Path) -> list[str]:
    """Return a line for each file that a wheel has too much, lacks, or states wrongly."""
    with zipfile.ZipFile(wheel) as archive:
        names = [name for name in archive.namelist() if not name.endswith("/")]
        (metadata,) = (name for name in names if name.endswith(".dist-info/METADATA"))
        text = archive.read(metadata).decode()
    dist_info = metadata.removesuffix("METADATA")
    suffix = ".pyd" if "-win" in wheel.name else ".abi3.so"
    source = ROOT / "src"
    modules = [path for path in tracked_files("src/touchfield") if path.is_relative_to(source)]
    package = {path.relative_to(source).as_posix() for path in modules}
    expected = package | {f"touchfield/_native{suffix}"} | {dist_info + name for name in _DIST_INFO}
    return [*_differences(wheel, set(names), expected), *_description_faults(wheel, text)]


def sdist_faults(sdist: Path) -> list[str]:
    """Return a line for each file that a source distribution has too much, lacks, or states wrongly."""
    root = sdist.name.removesuffix(".tar.gz")
    with tarfile.open(sdist) as archive:
        names = {member.name.removeprefix(root + "/") for member in archive if member.isfile()}
        information = archive.extractfile(f"{root}/PKG-INFO")
        text = information.read().decode() if information else ""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    sources = project["tool"]["hatch"]["build"]["targets"]["sdist"]["only-include"]
    expected = {path.relative_to(ROOT).as_posix() for path in tracked_files(*sources)} | _ADDED
    return [*_differences(sdist, names, expected), *_description_faults(sdist, text)]


def _differences(package: Path, names: set[str], expected: set[str]) -> list[str]:
    unexpected = [
        f"{package.name}: found {name}, which the repository does not have" for name in names - expected
    ]
    absent = [
        f"{package.name}: found no {name}; expected it, as in the repository" for name in expected - names
    ]
    return sorted(unexpected) + sorted(absent)


def _description_faults(package: Path, metadata: str) -> list[str]:
    """Return a line for each link of the description that leads nowhere on a package index."""
    description = metadata.partition("\n\n")[2]
    targets = re.findall(r"\]\(((?!https?://)[^)]+)\)", description)
    faults = [f"{package.name}: the description links to {target}; expected an address" for target in targets]
    return faults if description.strip() else [f"{package.name}: found no description; expected the README"]
