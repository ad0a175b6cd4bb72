"""Files that are written as a whole, and what a killed run leaves."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from touchfield.atomic import atomic_path, is_temporary, temporary_folder
from touchfield.errors import InvalidArgument
from touchfield.tasks.library import _list_files

needs_locks = pytest.mark.skipif(sys.platform == "win32", reason="no locks, so nothing is removed")


@contextmanager
def another_process_writes(code: str, target: Path) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """Run a program that has begun to write to `target`; yield it, and its temporary file or folder."""
    with subprocess.Popen(
        [sys.executable, "-c", code, target], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as writer:
        assert writer.stdout is not None and writer.stdout.readline() == b"writing\n"
        (temporary,) = target.parent.iterdir()
        assert is_temporary(temporary.name) and _list_files(target.parent).files == {}
        yield writer, temporary


@needs_locks
def test_the_next_write_removes_what_a_killed_run_left(tmp_path: Path) -> None:
    """A file that a living process writes is kept."""
    target = tmp_path / "a.touch"
    code = (
        "import sys; from pathlib import Path; from touchfield.atomic import atomic_path\n"
        "with atomic_path(Path(sys.argv[1])) as path:\n"
        "    path.write_bytes(b'part'); print('writing', flush=True); sys.stdin.read()"
    )
    with another_process_writes(code, target) as (writer, other):
        with atomic_path(target) as path:
            path.write_bytes(b"first")
        assert {p.name for p in tmp_path.iterdir()} == {"a.touch", other.name}
        writer.kill()
    assert other.read_bytes() == b"part"
    with atomic_path(target) as path:
        path.write_bytes(b"second")
    assert [p.name for p in tmp_path.iterdir()] == ["a.touch"] and target.read_bytes() == b"second"


@needs_locks
def test_the_next_write_removes_the_folder_that_a_killed_run_left(tmp_path: Path) -> None:
    target = tmp_path / "a.mpd"
    code = (
        "import sys; from pathlib import Path; from touchfield.atomic import temporary_folder\n"
        "with temporary_folder(Path(sys.argv[1])) as folder:\n"
        "    (folder / 'a.touch').write_bytes(b'part'); print('writing', flush=True); sys.stdin.read()"
    )
    with another_process_writes(code, target) as (writer, other):
        with temporary_folder(target):
            assert (other / "a.touch").exists(), "a living process writes to it"
        writer.kill()
    (tmp_path / ".a.0123abcd.mpd").write_bytes(b"no folder")
    (tmp_path / ".b.0123abcd.mpd").mkdir()
    with temporary_folder(target) as folder:
        (folder / "left.mp4").write_bytes(b"")
    assert sorted(path.name for path in tmp_path.iterdir()) == [".a.0123abcd.mpd", ".b.0123abcd.mpd"]
    with (
        pytest.raises(InvalidArgument, match=r"found no folder .*nowhere.* Make it first"),
        temporary_folder(tmp_path / "nowhere" / "a.mpd"),
    ):
        pass


@needs_locks
def test_only_leftovers_of_the_same_target_are_removed(tmp_path: Path) -> None:
    target, outside = tmp_path / "a.b.touch", tmp_path / "outside"
    outside.write_bytes(b"outside")
    kept = (
        ".a.b.0123abcd.npz",
        ".a.0123abcd.touch",
        ".a.b.0123abcg.touch",
        ".a.b.0123abcd1.touch",
        "a.b.0123abcd.touch",
    )
    for name in (*kept, ".a.b.0123abcd.touch", ".a.b.ffffffff.touch"):
        (tmp_path / name).write_bytes(b"")
    (tmp_path / ".a.b.11111111.touch").mkdir()
    (tmp_path / ".a.b.22222222.touch").symlink_to(outside)
    with pytest.raises(ZeroDivisionError), atomic_path(target) as path:
        assert path.exists() and 1 / 0
    left = {".a.b.11111111.touch", ".a.b.22222222.touch", "outside"}
    assert {p.name for p in tmp_path.iterdir()} == {*kept, *left} and outside.read_bytes() == b"outside"


@needs_locks
def test_two_writers_of_one_target_do_not_disturb_each_other(tmp_path: Path) -> None:
    target = tmp_path / "a"
    with atomic_path(target) as outer:
        outer.write_bytes(b"outer")
        with atomic_path(target) as inner:
            inner.write_bytes(b"inner")
        assert target.read_bytes() == b"inner"
    assert target.read_bytes() == b"outer" and [p.name for p in tmp_path.iterdir()] == ["a"]


def test_temporary_files_are_known_by_their_names() -> None:
    for name in (".a.0123abcd.touch", ".a b.c.0123abcd.npz", ".a.0123abcd"):
        assert is_temporary(name)
    for name in (
        "a.0123abcd.touch",
        ".hidden.touch",
        ".0123abcd.touch",
        ".a.0123ABCD.touch",
        ".a.0123abc.touch",
    ):
        assert not is_temporary(name)
