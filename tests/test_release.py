"""What `make release` checks and writes by itself, without building a package."""

from __future__ import annotations

import hashlib
import re
import subprocess
import sys
import zipfile
from collections.abc import Iterable
from functools import partial
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "build_backend"))

import description  # noqa: E402
import packages  # noqa: E402
import release  # noqa: E402
import set_version  # noqa: E402
import wheels  # noqa: E402


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


def test_a_folder_of_other_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "touchfield-0.0.1.tar.gz").touch()
    with pytest.raises(SystemExit, match="found files; expected an empty folder"):
        release.prepare_folder(tmp_path, "a" * 40)
    assert [path.name for path in tmp_path.iterdir()] == ["touchfield-0.0.1.tar.gz"]


def test_an_interrupted_release_goes_on_only_for_its_commit(tmp_path: Path) -> None:
    release.prepare_folder(tmp_path, "a" * 40)
    (tmp_path / "touchfield-0.2.0.tar.gz").touch()
    release.prepare_folder(tmp_path, "a" * 40)
    with pytest.raises(SystemExit, match="expected an empty folder"):
        release.prepare_folder(tmp_path, "b" * 40)
    assert (tmp_path / "touchfield-0.2.0.tar.gz").exists()


def test_what_an_interrupted_run_left_incomplete_is_removed(tmp_path: Path) -> None:
    (tmp_path / ".touchfield-site-0.2.0.zip.part").touch()
    (tmp_path / ".wheel-abc").mkdir()
    (tmp_path / ".wheel-abc" / "touchfield-0.2.0-cp311-abi3-win_amd64.whl").touch()
    (tmp_path / "touchfield-0.2.0-cp311-abi3-musllinux_1_2_x86_64.whl").touch()
    release.remove_parts(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [
        "touchfield-0.2.0-cp311-abi3-musllinux_1_2_x86_64.whl"
    ]


def test_files_of_no_commit_are_not_used_again(tmp_path: Path) -> None:
    release.prepare_folder(tmp_path, "")
    with pytest.raises(SystemExit, match="expected an empty folder"):
        release.prepare_folder(tmp_path, "")


def git(root: Path, *arguments: str) -> None:
    """Run git in a folder, as a person without settings."""
    person = ["-c", "user.name=Someone", "-c", "user.email=someone@example.org", "-c", "commit.gpgsign=false"]
    subprocess.run(["git", *person, *arguments], cwd=root, check=True, capture_output=True)


def test_only_a_commit_without_unreleased_changes_is_published(tmp_path: Path) -> None:
    write_version_places(tmp_path, "0.2.0")
    git(tmp_path, "init")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-m", "all")
    assert release.publication_faults(tmp_path, "0.2.0") == []
    git(tmp_path, "tag", "v0.2.0")
    assert release.publication_faults(tmp_path, "0.2.0") == []
    changelog = tmp_path / "CHANGELOG.md"
    changelog.write_text("## Unreleased\n- More.\n" + changelog.read_text())
    unreleased, uncommitted = release.publication_faults(tmp_path, "0.2.0")
    assert "found the section Unreleased" in unreleased
    assert "CHANGELOG.md" in uncommitted
    git(tmp_path, "commit", "-am", "more")
    _, tagged = release.publication_faults(tmp_path, "0.2.0")
    assert tagged.startswith("the tag v0.2.0 is at commit")


def test_missing_tools_are_named_in_one_line() -> None:
    assert wheels.missing_tools(["hashlib"], "release") == []
    (fault,) = wheels.missing_tools(["hashlib", "no_such_tool", "nor_this"], "release")
    assert "found no no_such_tool, nor_this" in fault
    assert "make release" in fault


def test_the_first_failing_task_ends_the_run_and_is_named() -> None:
    started = []

    def fail() -> None:
        wheels.run([sys.executable, "-c", "raise SystemExit(3)"])

    tasks = [fail, *[lambda number=number: started.append(number) for number in range(100)]]
    with pytest.raises(subprocess.CalledProcessError, match="status 3"):
        wheels.run_all(tasks)
    assert wheels.run_all([partial(started.append, 100)]) is None
    assert started[-1] == 100


def test_the_description_has_no_link_or_picture_of_the_repository() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    text = description.description(readme)
    code = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)
    assert code.findall(text) == code.findall(readme)
    assert not re.findall(r"\]\((?!https?://)", code.sub("", text))
    assert "the paper map lists the code" in text
    kept = "[paper](https://example.org/p), ![mark](https://example.org/m.svg)\n"
    assert description.description("![a field](docs/a.png)\n\n*A field.*\n\n" + kept) == kept


def write_wheel(path: Path, names: Iterable[str], text: str) -> None:
    """Write an archive with empty files, and a description."""
    with zipfile.ZipFile(path, "w") as archive:
        for name in names:
            archive.writestr(name, "")
        archive.writestr("touchfield-0.2.0.dist-info/METADATA", f"Name: touchfield\n\n{text}")


def test_each_file_too_many_or_missing_in_a_wheel_is_named(tmp_path: Path) -> None:
    source = ROOT / "src"
    names = {
        path.relative_to(source).as_posix()
        for path in packages.tracked_files("src")
        if source in path.parents
    }
    information = {"WHEEL", "RECORD", "entry_points.txt", "licenses/LICENSE"}
    names |= {f"touchfield-0.2.0.dist-info/{name}" for name in information} | {"touchfield/_native.abi3.so"}
    wheel = tmp_path / "touchfield-0.2.0-cp311-abi3-musllinux_1_2_x86_64.whl"
    write_wheel(wheel, names, "A field.")
    assert packages.wheel_faults(wheel) == []
    write_wheel(wheel, names - {"touchfield/py.typed"} | {"touchfield/scan.npz"}, "[map](docs/map.md)")
    unexpected, absent, link = packages.wheel_faults(wheel)
    assert "found touchfield/scan.npz" in unexpected
    assert "found no touchfield/py.typed" in absent
    assert "links to docs/map.md" in link


def test_a_new_version_is_stated_in_all_places_or_in_none(tmp_path: Path) -> None:
    write_version_places(tmp_path, "0.2.0")
    module = tmp_path / "src" / "touchfield" / "_version.py"
    module.parent.mkdir(parents=True)
    module.write_text('__version__ = "0.2.0"\n')
    with pytest.raises(ValueError, match=r"CHANGELOG.md: found 0 lines"):
        set_version.edited(tmp_path, "0.3.0", "2027-01-02")
    changelog = tmp_path / "CHANGELOG.md"
    changelog.write_text(changelog.read_text().replace("## 0.2.0", "## Unreleased\n- More.\n\n## 0.2.0"))
    for path, text in set_version.edited(tmp_path, "0.3.0", "2027-01-02").items():
        path.write_text(text)
    assert release.version_faults(tmp_path, "0.3.0") == []
    assert module.read_text() == '__version__ = "0.3.0"\n'
    assert "## 0.3.0 - 2027-01-02\n- More.\n\n## 0.2.0 - 2026-11-28" in changelog.read_text()


@pytest.mark.parametrize("version", ["", "0.2", "v0.3.0", "0.1.0", "0.0.9"])
def test_what_is_no_newer_version_is_refused(version: str) -> None:
    with pytest.raises(ValueError, match="found"):
        set_version.edited(ROOT, version, "2027-01-02")


def test_this_repository_takes_a_new_version_once_it_has_unreleased_changes() -> None:
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    if "\n## Unreleased\n" not in changelog:
        pytest.skip("the changelog has no unreleased changes")
    names = {path.relative_to(ROOT).as_posix() for path in set_version.edited(ROOT, "99.0.0", "2027-01-02")}
    assert names == set(set_version.PLACES)
