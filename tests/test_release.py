"""What `make release` checks and writes by itself, without building a package."""

from __future__ import annotations

import hashlib
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "build_backend"))

import release  # noqa: E402


def write_version_places(root: Path, version: str, dated: str = "2026-11-28") -> None:
    """Write the files that state a version."""
    (root / "docs").mkdir(exist_ok=True)
    (root / "CITATION.cff").write_text(f"cff-version: 1.2.0\nversion: {version}\n")
    (root / "docs" / "stability.md").write_text(f"# What is stable\ntouchfield is at version {version}. It\n")
    (root / "CHANGELOG.md").write_text(f"# Changelog\n\n## {version} - {dated}\n- All.\n")


def test_the_places_of_this_repository_state_its_version() -> None:
    assert release.version_faults(ROOT, release.version()) == []


def test_each_place_with_another_version_is_named(tmp_path: Path) -> None:
    write_version_places(tmp_path, "0.2.0")
    assert release.version_faults(tmp_path, "0.2.0") == []
    faults = release.version_faults(tmp_path, "0.3.0")
    assert [fault.partition(":")[0] for fault in faults] == [
        "CITATION.cff",
        "docs/stability.md",
        "CHANGELOG.md",
    ]
    assert all("found no line for version 0.3.0" in fault for fault in faults)


def test_a_section_without_a_date_is_not_released(tmp_path: Path) -> None:
    write_version_places(tmp_path, "0.2.0", "unreleased")
    (fault,) = release.version_faults(tmp_path, "0.2.0")
    assert fault.startswith("CHANGELOG.md")


def test_equal_files_make_equal_archives_in_one_folder(tmp_path: Path) -> None:
    files = [tmp_path / "c" / name for name in ("touch.h", "touch_query.h")]
    files[0].parent.mkdir()
    for file in files:
        file.write_text(file.name)
    first, second = tmp_path / "touchfield-c-0.2.0.zip", tmp_path / "again" / "touchfield-c-0.2.0.zip"
    second.parent.mkdir()
    release.write_archive(first, files, tmp_path)
    release.write_archive(second, reversed(files), tmp_path)
    assert first.read_bytes() == second.read_bytes()
    with zipfile.ZipFile(first) as archive:
        assert archive.namelist() == ["touchfield-c-0.2.0/c/touch.h", "touchfield-c-0.2.0/c/touch_query.h"]
        assert archive.read("touchfield-c-0.2.0/c/touch.h") == b"touch.h"


def test_the_archives_have_the_licence_and_what_is_tracked() -> None:
    names = {path.relative_to(ROOT).as_posix() for path in release.tracked_files("c", "docs/format")}
    assert {"LICENSE", "c/touch.h", "docs/format/README.md"} <= names
    assert all(name == "LICENSE" or name.startswith(("c/", "docs/format/")) for name in names)


def test_sums_are_those_of_the_files(tmp_path: Path) -> None:
    (tmp_path / "b.whl").write_bytes(b"b")
    (tmp_path / "a.zip").write_bytes(b"a")
    release.write_sums(tmp_path)
    lines = [f"{hashlib.sha256(name[0].encode()).hexdigest()}  {name}" for name in ("a.zip", "b.whl")]
    assert (tmp_path / "SHA256SUMS").read_text().splitlines() == lines


def test_a_folder_with_files_is_refused_before_anything_is_built(tmp_path: Path) -> None:
    (tmp_path / "touchfield-0.0.1.tar.gz").touch()
    with pytest.raises(SystemExit, match="found files; expected an empty folder"):
        release.main(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["touchfield-0.0.1.tar.gz"]
