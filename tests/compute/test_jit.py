"""Compiled kernels: concurrent compilation, and calls from Python only of functions with a wrapper."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numba import njit

import touchfield
from child_environment import environment_with
from touchfield.compute.jit import inner, kernel
from touchfield.compute.numba_internals import KernelFiles

ROOT = Path(__file__).parents[2]
DECORATORS = {"njit", "kernel", "inner"}


def test_concurrently_saved_variants_have_separate_files(tmp_path: Path) -> None:
    first, second, later = (KernelFiles(str(tmp_path), "kernel-1.py311", "of one source") for _ in range(3))
    second._load_index = dict  # the index before the first process wrote it
    write = first._save_data

    def write_late(name: str, code: str) -> None:
        second.save("types of the second", "code of the second")
        write(name, code)

    first._save_data = write_late
    first.save("types of the first", "code of the first")
    assert later.load("types of the second") == "code of the second"
    # the index is that of the second process: the first variant is compiled again
    assert later.load("types of the first") is None
    later.save("types of the first", "code of the first")
    assert later.load("types of the second") == "code of the second"
    assert later.load("types of the first") == "code of the first"
    assert len(list(tmp_path.glob("*.nbc"))) == 2


def test_a_kernel_multiplies_matrices() -> None:
    """SciPy's BLAS is not imported with numba, but is found when a kernel needs it."""

    @kernel
    def product(a, b):
        return a @ b

    a, b = np.arange(6.0).reshape(2, 3), np.arange(12.0).reshape(3, 4)
    np.testing.assert_allclose(product(a, b), a @ b)


def test_kernels_work_without_private_parts_of_numba(tmp_path: Path) -> None:
    (tmp_path / "functions.py").write_text(
        "from touchfield.compute.jit import inner, kernel\n"
        "@inner\ndef double(x):\n    return 2 * x\n"
        "@inner(error_model='numpy')\ndef half(x):\n    return x / 2\n"
        "@kernel\ndef both(x):\n    return double(x) + half(x)\n"
    )
    code = (
        "import numba.core.caching as caching\ndel caching.InTreeCacheLocator\n"
        "from touchfield.compute import jit\nimport functions\n"
        "print(jit.numba_internals, jit.kernel_folder(), functions.both(3.0))"
    )
    environment = environment_with(tmp_path)
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.stdout.split() == ["None", "None", "7.5"], done.stderr


def test_only_jit_imports_njit_and_no_kernel_has_a_private_option() -> None:
    package = Path(str(touchfield.__file__)).parent
    files = [*package.rglob("*.py"), *(ROOT / "reproduction").rglob("*.py")]
    users = [path for path in files if re.search(r"numba.*\bnjit\b", path.read_text(), re.M)]
    assert users == [package / "compute" / "jit.py"]
    private = re.compile(r"\b(_nrt|pipeline_class)\b")
    assert [path for path in files if private.search(path.read_text())] == []


def names_for_python(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes outside of compiled functions."""
    for node in ast.iter_child_nodes(tree):
        decorators = [
            getattr(decorator, "func", decorator) for decorator in getattr(node, "decorator_list", [])
        ]
        if not any(
            isinstance(decorator, ast.Name) and decorator.id in DECORATORS for decorator in decorators
        ):
            yield node
            yield from names_for_python(node)


def inner_functions_that_python_names(tree: ast.Module, module: str = "") -> list[str]:
    """Functions without a wrapper, imported or defined in a file, that its Python code refers to."""
    names = vars(import_module(module)).copy() if module else {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("touchfield."):
            module_object = import_module(str(node.module))
            names |= {
                alias.asname or alias.name: getattr(module_object, alias.name, None) for alias in node.names
            }
    out = []
    for node in names_for_python(tree):
        value = None
        if isinstance(node, ast.Name):
            value = names.get(node.id)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            module_object = names.get(node.value.id)
            value = getattr(module_object, node.attr, None) if isinstance(module_object, ModuleType) else None
        if getattr(value, "targetoptions", {}).get("no_cpython_wrapper"):
            out.append(f"{value.__module__}.{value.__name__}")
    return out


def test_constants_of_a_caller_propagate_into_inner_functions() -> None:
    """The compiler needs the strides of loops to turn them into vector code."""

    @inner
    def shifted(n, by):
        return n + by

    @njit
    def outer(n):
        return shifted(n, 3) + shifted(n, n)

    assert outer(7) == 10 + 14
    assert sorted(map(str, shifted.signatures)) == ["(int64, Literal[int](3))", "(int64, int64)"]


@pytest.mark.parametrize("folder", ["src", "tests", "bench", "reproduction"])
def test_python_calls_no_function_without_a_wrapper(folder: str) -> None:
    count = 0
    for path in (ROOT / folder).rglob("*.py"):
        text = path.read_text()
        if "kernels" in text or "kernels" in path.parts:
            count += 1
            parts = path.relative_to(ROOT / folder).with_suffix("").parts
            module = (
                ".".join(parts).removesuffix(".__init__")
                if folder == "src" and "kernels" in str(path)
                else ""
            )
            assert inner_functions_that_python_names(ast.parse(text), module) == [], path
    assert count, f"{folder} has files that name kernels"


def test_calls_of_functions_without_a_wrapper_are_detected() -> None:
    function_import = "from touchfield.medium.kernels import lower_bound\n"
    module_import = "from touchfield.medium import kernels\n"
    calls = [
        f"{function_import}lower_bound(a, b)",
        f"{function_import}def f():\n    return lower_bound",
        f"{module_import}kernels.lower_bound(a, b)",
    ]
    assert [inner_functions_that_python_names(ast.parse(text)) for text in calls] == [
        ["touchfield.medium.kernels.lower_bound"]
    ] * 3
    assert (
        inner_functions_that_python_names(
            ast.parse(f"{function_import}@njit\ndef f(a):\n    return lower_bound(a, a)")
        )
        == []
    )
