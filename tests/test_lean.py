"""Compiled kernels kept on disk: two processes that compile at once do not get each other's code."""

from __future__ import annotations

import re
from pathlib import Path

from numba.core.caching import IndexDataCacheFile

import touchfield.lean


def test_two_variants_of_a_function_that_are_saved_at_once_do_not_share_a_file(tmp_path: Path) -> None:
    first, second, later = (IndexDataCacheFile(str(tmp_path), "kernel-1.py311", "of one source") for _ in range(3))
    second._load_index = dict  # as it was before the first wrote it
    write = first._save_data

    def write_late(name: str, code: str) -> None:
        second.save("types of the second", "code of the second")
        write(name, code)

    first._save_data = write_late
    first.save("types of the first", "code of the first")
    assert later.load("types of the second") == "code of the second"
    assert later.load("types of the first") is None  # the index is the second's: it is compiled again
    later.save("types of the first", "code of the first")
    assert later.load("types of the second") == "code of the second"
    assert later.load("types of the first") == "code of the first"
    assert len(list(tmp_path.glob("*.nbc"))) == 2


def test_every_kernel_is_saved_so() -> None:
    lean = Path(touchfield.lean.__file__)
    files = [*lean.parent.rglob("*.py"), *(Path(__file__).parents[1] / "reproduction").rglob("*.py")]
    assert [path for path in files if re.search(r"^from numba import .*\bnjit\b", path.read_text(), re.M)] == [lean]
