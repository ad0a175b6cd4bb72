"""Cached kernels: invalidated by changed sources, reused otherwise, and removed with time."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from collections import namedtuple
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from numba import types
from numba.core import caching
from numba.core.dispatcher import Dispatcher

from touchfield.compute import numba_internals
from touchfield.compute.kernel_sources import PACKAGE, SourceState, kernel_sources, open_folder

INNER = "medium/kernels/__init__.py"  # its `lower_bound` is compiled into CALLER
CALLER = """

from touchfield.medium.kernels import lower_bound


@kernel
def find(keys, key):
    return lower_bound(keys, key)
"""
CALL = """
import numpy as np
from touchfield.perception.kernels import find
keys = np.array([3, 5])
{before}
print(find(keys, 5), sum(find.stats.cache_hits.values()), {after})
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A copy of the package without compiled files, and with a kernel that calls one of another file."""
    target = tmp_path / "src" / "touchfield"
    shutil.copytree(PACKAGE, target, ignore=shutil.ignore_patterns("__pycache__", "web"))
    with (target / "perception" / "kernels.py").open("a") as file:
        file.write(CALLER)
    return target


def run(package: Path, before: str = "", after: str = "''", **environment: str) -> str:
    """Output of a new process that calls a kernel of this package: index of 5, cache hits, `after`."""
    inherited = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    process_environment = {
        **inherited,
        "PYTHONPATH": str(package.parent),
        "PYTHONDONTWRITEBYTECODE": "1",
        **environment,
    }
    code = [sys.executable, "-c", CALL.format(before=before, after=after)]
    return subprocess.run(
        code, env=process_environment, check=True, capture_output=True, text=True
    ).stdout.strip()


def replace(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_edit_of_an_inner_function_recompiles_its_callers_in_other_files(package: Path) -> None:
    assert run(package) == "1 0"
    replace(package / INNER, "return low", "return 0 * low")
    assert run(package) == "0 0"
    assert run(package) == "0 1"
    assert len(list((package / "compute" / "__pycache__").glob("kernels-*"))) == 2


@pytest.mark.parametrize("path", [path.relative_to(PACKAGE).as_posix() for path in kernel_sources()])
def test_the_digest_covers_every_kernel_source(package: Path, path: str) -> None:
    before = SourceState(kernel_sources(package), "", package)
    assert before.digest and before.is_current()
    (package / path).write_text((package / path).read_text() + "#\n")
    after = SourceState(kernel_sources(package), "", package)
    assert after.digest != before.digest and not before.is_current()
    assert SourceState(kernel_sources(package), "another numba", package).digest != after.digest


def constants_of(module: ModuleType) -> Iterator[str]:
    """Modules from which a kernel file imports possible constants of its compiled functions."""
    functions = [value.py_func for value in vars(module).values() if isinstance(value, Dispatcher)]
    names = {
        name for function in functions if function.__module__ == module.__name__ for name in reads(function)
    }
    for node in ast.walk(ast.parse(Path(str(module.__file__)).read_text())):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("touchfield."):
            for alias in node.names:
                value = getattr(module, alias.asname or alias.name, None)
                if (alias.asname or alias.name) in names:
                    yield value.__name__ if isinstance(value, ModuleType) else str(node.module)


def reads(function: object) -> set[str]:
    """Global names in the code of a function and of its nested functions."""
    codes, names = [function.__code__], set()  # type: ignore[attr-defined]
    while codes:
        code = codes.pop()
        names |= set(code.co_names)
        codes += [value for value in code.co_consts if hasattr(value, "co_names")]
    return names


def test_every_file_whose_constants_are_compiled_in_is_a_kernel_source() -> None:
    """A function that a kernel calls is itself a kernel, so its file must be a kernel source."""
    sources = {path.resolve() for path in kernel_sources()}
    checked = set()
    for path in sources:
        module = import_module(module_name(path))
        for name in constants_of(module):
            checked.add(name)
            assert Path(str(import_module(name).__file__)).resolve() in sources, (
                f"{name}, of {module.__name__}"
            )
    assert {"touchfield.medium.kernels", "touchfield.medium.kernels.placed"} <= checked
    # of these, constants of kernels are computed when a kernel source is imported
    assert {PACKAGE / "render" / "block" / "layout.py", PACKAGE / "medium" / "grid.py"} <= sources


def test_every_compiled_function_lies_in_a_kernel_source() -> None:
    files = {
        path
        for path in PACKAGE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ImportFrom) and node.module == "touchfield.compute.jit"
        if {alias.name for alias in node.names} & {"kernel", "inner"}
    }
    assert files and files <= set(kernel_sources())


def module_name(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent.resolve()).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


def test_process_older_than_its_sources_stores_no_kernels(package: Path) -> None:
    edit = f"open({str(package / INNER)!r}, 'a').write('#')"
    assert run(package, before=edit) == "1 0"
    assert not list(package.rglob("*.nbc"))


def test_read_only_package_uses_the_user_cache(package: Path, tmp_path: Path) -> None:
    (package / "compute" / "__pycache__").write_text("a file, not a folder")
    user = {"HOME": str(tmp_path / "home"), "XDG_CACHE_HOME": str(tmp_path / "home" / "cache")}
    assert run(package, **user) == "1 0"
    assert run(package, **user) == "1 1"
    assert list((tmp_path / "home").rglob("*kernels.find*.nbc"))
    (tmp_path / "nobody").write_text("a file, not a folder")
    nowhere = {"HOME": str(tmp_path / "nobody"), "XDG_CACHE_HOME": str(tmp_path / "nobody" / "cache")}
    assert run(package, **nowhere) == "1 0"


def test_environment_variable_selects_the_folder(package: Path, tmp_path: Path) -> None:
    folder = str(tmp_path / "named")
    assert [run(package, NUMBA_CACHE_DIR=folder) for _ in range(2)] == ["1 0", "1 1"]
    assert list(Path(folder).rglob("*kernels.find*.nbc")) and not list(package.rglob("*.nbc"))


@pytest.mark.parametrize("obstacle", ["", "; folder.touch()"])
def test_removed_cache_folder_is_created_again(package: Path, obstacle: str) -> None:
    """It is created again; if a file has its name, kernels are neither read nor written."""
    run(package)
    remove = (
        "import shutil; from touchfield.compute.jit import kernel_folder; folder = kernel_folder(); "
        "shutil.rmtree(folder)"
    )
    assert run(package, before=remove + obstacle) == "1 0"
    if not obstacle:
        assert run(package) == "1 1"


def test_kernels_of_other_packages_are_stored_as_numba_stores_them(package: Path, tmp_path: Path) -> None:
    (tmp_path / "stranger.py").write_text(
        "from numba import njit\n@njit(cache=True)\ndef double(x):\n    return 2 * x\n"
    )
    before = f"import sys; sys.path.append({str(tmp_path)!r}); from stranger import double; double(2)"
    run(package, before=before)
    (name,) = [path.name for path in tmp_path.joinpath("__pycache__").glob("*.nbc")]
    assert name.startswith("stranger.double-2.") and name.endswith(".1.nbc") and name.count(".") == 4
    assert caching.IndexDataCacheFile.save.__module__ == caching.__name__


def test_folders_of_former_sources_are_removed(tmp_path: Path) -> None:
    for age, name in enumerate(["first", "second", "third", "fourth"]):
        folder = open_folder(tmp_path, name)
        os.utime(folder, (1000 * age, 1000 * age))
    (tmp_path / "other").mkdir()
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "kernels-fourth", "kernels-second", "kernels-third", "other",
    ]  # fmt: skip
    open_folder(tmp_path, "second")  # which is now the most recently used
    open_folder(tmp_path, "fifth")
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "kernels-fifth", "kernels-fourth", "kernels-second", "other",
    ]  # fmt: skip


def test_named_tuples_of_other_fields_are_other_variants() -> None:
    pairs: list[Any] = [
        types.NamedUniTuple(types.int64, 2, namedtuple("Pair", names)) for names in ("a b", "b a")
    ]
    within: list[Any] = [types.UniTuple(pair, 2) for pair in pairs]
    for first, second in (pairs, within):
        assert numba_internals.field_names([types.int64, first]) != numba_internals.field_names(
            [types.int64, second]
        )
        assert numba_internals.field_names([types.int64, first]) == numba_internals.field_names(
            [types.int64, first]
        )
