"""What `make release` checks and writes by itself, without building a package."""

from __future__ import annotations

import hashlib
import os
import re
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterable
from functools import partial
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "build_backend"))

import archives  # noqa: E402
import description  # noqa: E402
import packages  # noqa: E402
import release  # noqa: E402
import set_version  # noqa: E402
import wheels  # noqa: E402


def write_version_places(root: Path, version: str, dated: str = "2026-11-28") -> None:
    """Write the files that state a version."""
    (root / "docs").mkdir(exist_ok=True)
    released = "" if dated == "unreleased" else f"date-released: {dated}\n"
    (root / "CITATION.cff").write_text(f"cff-version: 1.2.0\nversion: {version}\n{released}")
    (root / "docs" / "stability.md").write_text(f"# What is stable\ntouchfield is at version {version}. It\n")
    (root / "CHANGELOG.md").write_text(f"# Changelog\n\n## {version} - {dated}\n- All.\n")


def test_the_places_of_this_repository_state_its_version() -> None:
    assert release.version_faults(ROOT, release.version()) == []


def test_each_place_with_another_version_is_named(tmp_path: Path) -> None:
    write_version_places(tmp_path, "0.2.0")
    assert release.version_faults(tmp_path, "0.2.0") == []
    for other in ("0.3.0", "0.2.0.1", "0.2"):
        faults = release.version_faults(tmp_path, other)
        assert [fault.partition(";")[0] for fault in faults] == [
            f'CITATION.cff: found no line "version: {other}"',
            'CITATION.cff: found no line "date-released: YYYY-MM-DD"',
            f'docs/stability.md: found no line "touchfield is at version {other}."',
            f'CHANGELOG.md: found no line "## {other} - YYYY-MM-DD"',
        ]


def test_a_section_without_a_date_is_not_released(tmp_path: Path) -> None:
    write_version_places(tmp_path, "0.2.0", "unreleased")
    citation, changelog = release.version_faults(tmp_path, "0.2.0")
    assert 'found no line "date-released: YYYY-MM-DD"' in citation
    assert 'found no line "## 0.2.0 - YYYY-MM-DD"' in changelog


def test_the_citation_has_the_date_of_the_changelog(tmp_path: Path) -> None:
    write_version_places(tmp_path, "0.2.0")
    changelog = tmp_path / "CHANGELOG.md"
    changelog.write_text(changelog.read_text().replace("2026-11-28", "2026-11-30"))
    (fault,) = release.version_faults(tmp_path, "0.2.0")
    assert fault.startswith('CITATION.cff: found no line "date-released: 2026-11-30"')


def test_equal_files_make_equal_archives_in_one_folder(tmp_path: Path) -> None:
    files = [tmp_path / "c" / name for name in ("touch.h", "touch_query.h")]
    files[0].parent.mkdir()
    for file in files:
        file.write_text(file.name)
    first, second = tmp_path / "touchfield-c-0.2.0.zip", tmp_path / "again" / "touchfield-c-0.2.0.zip"
    second.parent.mkdir()
    archives.write_archive(first, files, tmp_path)
    archives.write_archive(second, reversed(files), tmp_path)
    assert first.read_bytes() == second.read_bytes()
    with zipfile.ZipFile(first) as archive:
        assert archive.namelist() == ["touchfield-c-0.2.0/c/touch.h", "touchfield-c-0.2.0/c/touch_query.h"]
        assert archive.read("touchfield-c-0.2.0/c/touch.h") == b"touch.h"


def test_pages_of_an_archive_link_to_what_it_has() -> None:
    names = ["c/README.md", "c/touch.h", "docs/format/README.md", "docs/format/live.md"]
    text = "[header](touch.h#top), [format](../docs/format/), [pages](../docs/map.md#two), [there](https://e.org)"
    kept = "[header](touch.h#top), [format](../docs/format/), pages, [there](https://e.org)"
    assert archives.page_in_archive(text, "c/README.md", names) == kept
    own = "[records](#records), ![a field](live.md)"
    assert archives.page_in_archive(own, "docs/format/README.md", names) == own


@pytest.mark.parametrize("name", archives.CONTENTS)
def test_an_archive_has_the_licence_and_no_link_to_other_files(name: str, tmp_path: Path) -> None:
    archives.write_contents(tmp_path, name, "0.2.0")
    with zipfile.ZipFile(archives.archive_path(tmp_path, name, "0.2.0")) as archive:
        archive.extractall(tmp_path)
    root = tmp_path / f"touchfield-{name}-0.2.0"
    assert {"LICENSE", "docs", name} <= {path.name for path in root.iterdir()}
    pages = [*root.rglob("*.md")]
    links = [(page, link) for page in pages for link in re.findall(r"\]\(([^)#\s]+)", page.read_text())]
    assert len(links) > 10
    assert [
        (page, link) for page, link in links if "://" not in link and not (page.parent / link).exists()
    ] == []


def test_code_in_pages_of_an_archive_stays() -> None:
    code = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)
    files = archives.tracked_files("c", "conformance", "integrations", "docs/format")
    for page in (path for path in files if path.suffix == ".md"):
        text = page.read_text(encoding="utf-8")
        assert code.findall(archives.page_in_archive(text, "README.md", ())) == code.findall(text)


def test_the_decoders_of_the_archives_work_without_the_repository(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in archives.CONTENTS:
        archives.write_contents(tmp_path, name, "0.2.0")
    archives.check_archives(tmp_path, "0.2.0")
    assert str(ROOT / "c") not in (shown := capsys.readouterr().out) and "touch_decode.c" in shown


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


def test_a_folder_without_a_repository_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    with pytest.raises(SystemExit, match="found no commit that git can read; expected a clone"):
        release.repository_state(tmp_path)
    git(tmp_path, "init")
    with pytest.raises(SystemExit, match="found no commit"):
        release.repository_state(tmp_path)


def test_changes_during_the_build_are_refused(tmp_path: Path) -> None:
    write_version_places(tmp_path, "0.2.0")
    git(tmp_path, "init")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-m", "all")
    state = release.repository_state(tmp_path)
    release.check_unchanged(tmp_path, state)
    (tmp_path / "CITATION.cff").write_text("")
    with pytest.raises(SystemExit, match="changes that were made during the build"):
        release.check_unchanged(tmp_path, state)
    git(tmp_path, "commit", "-am", "more")
    with pytest.raises(SystemExit, match="changes that were made during the build"):
        release.check_unchanged(tmp_path, state)


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


def test_the_failing_command_is_reported_without_its_program() -> None:
    with pytest.raises(SystemExit, match="status 3") as ended:
        wheels.main_of_command(
            lambda: wheels.run([sys.executable, "-c", "import sys\nsys.exit(3)", "one.touch"])
        )
    assert str(ended.value).startswith(f"failed with status 3: {sys.executable} -c one.touch\n")


def test_an_interrupted_run_starts_no_further_task() -> None:
    started = []

    def interrupt() -> None:
        time.sleep(0.1)
        os.kill(os.getpid(), signal.SIGINT)

    tasks = [
        interrupt,
        *[lambda number=number: started.append(number) or time.sleep(0.05) for number in range(400)],
    ]
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in a background process
    try:
        with pytest.raises(SystemExit, match="interrupted"):
            wheels.main_of_command(lambda: wheels.run_all(tasks))
    finally:
        signal.signal(signal.SIGINT, before)
    assert len(started) < 400


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


@pytest.mark.parametrize(
    ("needed", "is_accepted"),
    [
        ("manylinux_2_17_x86_64", True),
        ("manylinux_2_5_x86_64", True),
        ("manylinux_2_36_x86_64", False),
        ("manylinux_2_17_aarch64", False),
        ("linux_x86_64", False),
    ],
)
def test_a_wheel_that_needs_a_newer_glibc_than_its_name_states_is_refused(
    needed: str, is_accepted: bool
) -> None:
    wheel = "touchfield-0.2.0-cp311-abi3-manylinux_2_17_x86_64.manylinux2014_x86_64.whl"
    fault = wheels.glibc_fault(wheel, needed)
    assert (fault is None) == is_accepted
    assert fault is None or f"found that it needs {needed}" in fault


def test_a_new_version_is_stated_in_all_places_or_in_none(tmp_path: Path) -> None:
    write_version_places(tmp_path, "0.2.0")
    module = tmp_path / "src" / "touchfield" / "_version.py"
    module.parent.mkdir(parents=True)
    module.write_text('__version__ = "0.2.0"\n')
    with pytest.raises(
        ValueError, match=r'CHANGELOG.md: found 0 lines such as "## Unreleased"; expected one'
    ):
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


def test_this_repository_takes_a_new_version(tmp_path: Path) -> None:
    for name in {name for name, _, _ in set_version.PLACES}:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text((ROOT / name).read_text(encoding="utf-8"), encoding="utf-8")
    changelog = tmp_path / "CHANGELOG.md"
    text = changelog.read_text(encoding="utf-8")
    if "\n## Unreleased\n" not in text:  # just after a release
        changelog.write_text(text.replace("\n## ", "\n## Unreleased\n- More.\n\n## ", 1), encoding="utf-8")
    for path, new in set_version.edited(tmp_path, "99.0.0", "2027-01-02").items():
        path.write_text(new, encoding="utf-8")
    assert release.version_faults(tmp_path, "99.0.0") == []
    assert len(release.version_faults(tmp_path, release.version())) == 3
