"""Finds what a measured result depends on (code, commit, machine load), so that results of older code are
known to be stale.

The code of a result is every source file that the processes of its benchmark loaded, the data files of loaded
packages (device profiles; a built page only where a module names it), and the files that the benchmark names
(such as a program in C). Of the C core it is the functions that the loaded modules and these programs name,
with all declarations that they need: a change of the renderer leaves the bytes of a coder as they are.
Hashes ignore comments, docstrings and layout of Python, C and TypeScript. They also ignore the folder of a
file, because other files then import the same names from another module.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import re
import resource
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import c_declarations

BENCH: Final = Path(__file__).resolve().parent
ROOT: Final = BENCH.parent
FOLDERS: Final = ("src", "bench", "tests", "reproduction")
NOT_MEASURED: Final = frozenset(
    (
        "bench/c_declarations.py",
        "bench/machine.py",
        "bench/provenance.py",
        "bench/run_all.py",
        "bench/quotes.py",
        "bench/trace/sitecustomize.py",
        "src/touchfield/_version.py",
    )
)
"""Files that run, report and store, and take no part in a measurement. A result states the version that it
was measured with, and a release does not make it stale."""
NATIVE: Final = ROOT / "c" / "python"
"""The compiled module, whose headers list their functions as `{"name", function, ...}`."""
COMPILED: Final = "c (what the functions in use need)"
"""The line of a record for these functions; the others are paths of files."""
NOT_DATA: Final = frozenset(
    (".py", ".pyc", ".pyi", ".nbi", ".nbc", ".typed", ".so", ".pyd", ".pdb", ".dylib")
)
VARIABLE: Final = "TOUCHFIELD_BENCH_TRACE"
"""Environment variable with the folder where processes list the files they loaded."""
_FUNCTION: Final = re.compile(r"\{\"(\w+)\", (?:FAST_FUNCTION\()?(\w+)\)?, METH")
_NATIVE_NAME: Final = re.compile(r"\bnative\.(\w+)")
_C_TOKENS: Final = re.compile(rf"{c_declarations.STRINGS}|//[^\n]*|/\*.*?\*/|\s+", re.DOTALL)


# -- files and their hashes --------------------------------------------------------------------------------


class Trace:
    """Record the files that this process and its children load."""

    def __init__(self) -> None:
        _require_this_package()
        self._folder = TemporaryDirectory(prefix="touchfield-bench-")
        before = os.environ.get("PYTHONPATH", "")
        os.environ[VARIABLE] = self._folder.name
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(BENCH / "trace"), before]))

    def files(self, also: Iterable[str] = ()) -> list[str]:
        """Return the loaded files as sorted paths below the root of the repository.

        `also` are patterns of further files.
        """
        loaded = {str(getattr(module, "__file__", None) or "") for module in list(sys.modules.values())}
        loaded.add(str(Path(sys.argv[0]).resolve()))
        for path in Path(self._folder.name).glob("*.txt"):
            loaded.update(path.read_text(encoding="utf-8").splitlines())
        sources = {path for name in loaded for path in _source(name)}
        sources.update(path for pattern in also for path in ROOT.glob(pattern) if path.is_file())
        packages = {path.parent for path in sources if path.name == "__init__.py"}
        sources.update(path for package in packages for path in _data_of(package))
        files = {path.relative_to(ROOT).as_posix() for path in sources} - NOT_MEASURED
        is_compiled = any(Path(name).name.startswith("_native.") for name in loaded)
        if is_compiled or any(file.endswith(".c") for file in files):
            files.add(COMPILED)
        return sorted(files - unread_pages(files))


def _require_this_package() -> None:
    """Exit if Python would import the package of another folder, whose code differs."""
    found = find_spec("touchfield")
    origin = None if found is None else found.origin
    if origin is None or not Path(origin).is_relative_to(ROOT):
        sys.exit(f"touchfield is {origin or 'not installed'}, not that of {ROOT}: pip install -e {ROOT}")


def _source(name: str) -> Iterator[Path]:
    """Yield the file of a Python module if it belongs to the repository."""
    path = Path(name)
    if path.suffix == ".py" and path.is_relative_to(ROOT) and path.relative_to(ROOT).parts[0] in FOLDERS:
        yield path


def compiled_roots(files: Iterable[str]) -> frozenset[str]:
    """Return the functions of C that files use: as ``native.cycle`` in Python, by any name in C programs."""
    present = [ROOT / file for file in files if (ROOT / file).is_file()]
    modules = [path.read_text(encoding="utf-8") for path in present if path.suffix == ".py"]
    programs = [path.read_text(encoding="utf-8") for path in present if path.suffix == ".c"]
    names = {name for text in modules for name in _NATIVE_NAME.findall(text)}
    named = (c_declarations.words(c_declarations.without_comments(text)) for text in programs)
    return frozenset(function for name, function in native_functions() if name in names).union(*named)


@cache
def compiled_digest(roots: frozenset[str]) -> str:
    """Return a hash of functions of C, and of all that they need.

    The binary of the compiled module differs between compilers, and holds all functions.
    """
    found = c_declarations.needed(_native_declarations(), roots)
    return _hash("\n".join(declaration.text for declaration in found))


@cache
def native_functions() -> tuple[tuple[str, str], ...]:
    """Return the name of each function of the compiled module in Python, and in C."""
    texts = [path.read_text(encoding="utf-8") for path in sorted(NATIVE.glob("*.h"))]
    return tuple(pair for text in texts for pair in _FUNCTION.findall(text))


@cache
def _native_declarations() -> dict[str, list[c_declarations.Declaration]]:
    headers = [*sorted(NATIVE.glob("*.h")), *sorted(NATIVE.parent.glob("*.h"))]
    return c_declarations.by_name(path.read_text(encoding="utf-8") for path in headers)


def _data_of(package: Path) -> Iterator[Path]:
    """Yield the files of a package that are not Python.

    Files of nested packages are left out.
    """
    for path in package.iterdir():
        if path.is_dir() and path.name != "__pycache__" and not (path / "__init__.py").exists():
            yield from _data_of(path)
        elif path.is_file() and path.suffix not in NOT_DATA:
            yield path


def unread_pages(files: Iterable[str]) -> set[str]:
    """Return the built pages of loaded packages that no loaded module names, so that none was read."""
    files = set(files)
    pages = {file for file in files if file.endswith(".html")}
    modules = [ROOT / file for file in files if pages and file.endswith(".py")]
    texts = [path.read_text(encoding="utf-8") for path in modules if path.is_file()]
    return {page for page in pages if not any(Path(page).name in text for text in texts)}


@cache
def digest(file: str) -> str:
    """Return a hash of the meaning of a file; "missing" if there is none."""
    path = ROOT / file
    if not path.is_file():
        return "missing"
    text = path.read_bytes().decode("utf-8", "surrogateescape")
    if path.suffix == ".py":
        meaning = python_meaning(text, is_bench=file.startswith("bench/"))
    elif path.suffix in (".c", ".h", ".ts", ".js", ".mjs"):
        meaning = c_meaning(text)
    elif path.suffix == ".toml":
        meaning = json.dumps(tomllib.loads(text), sort_keys=True, default=str)
    else:
        meaning = text.replace("\r\n", "\n")
    return _hash(meaning)


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()[:16]


def python_meaning(text: str, is_bench: bool = False) -> str:
    """Return Python without comments, docstrings and layout, equal in all versions.

    Of imports only the names count, in alphabetical order, because the modules they come from are files of
    their own. In a benchmark the function `bars` does not count, because it only judges figures.
    """
    tree = ast.parse(text)
    parts = [f"imports {' '.join(sorted(_imported_names(tree)))}\n"]
    _write_node(tree, parts, is_bench)
    return "".join(parts)


def _imported_names(tree: ast.Module) -> Iterator[str]:
    """Yield the names that imports define, with the names they had in their modules."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            yield from (f"{alias.name.rpartition('.')[2]}:{alias.asname or ''}" for alias in node.names)


def _write_node(node: ast.AST, parts: list[str], is_bench: bool) -> None:
    if isinstance(node, (ast.Import, ast.ImportFrom)):
        return
    parts.append(f"({type(node).__name__}")
    for name, value in ast.iter_fields(node):
        if value is None or value == []:
            continue  # newer versions of Python have more fields, mostly empty
        parts.append(f" {name}=")
        if isinstance(value, list):
            for item in _without_strings(value) if name == "body" else value:
                if is_bench and isinstance(node, ast.Module) and getattr(item, "name", "") == "bars":
                    continue
                if isinstance(item, ast.AST):
                    _write_node(item, parts, is_bench)
                else:
                    parts.append(repr(item))
        elif isinstance(value, ast.AST):
            _write_node(value, parts, is_bench)
        else:
            parts.append(repr(value))
    parts.append(")")


def _without_strings(body: list[Any]) -> list[Any]:
    """Return the statements of a body without docstrings and other string statements."""

    def is_string(statement: Any) -> bool:
        return (
            isinstance(statement, ast.Expr)
            and isinstance(statement.value, ast.Constant)
            and isinstance(statement.value.value, str)
        )

    return [statement for statement in body if not is_string(statement)]


def c_meaning(text: str) -> str:
    """Return C or TypeScript without comments, with white space collapsed."""
    return (
        _C_TOKENS.sub(lambda found: found[0] if found[0][0] in "\"'`" else " ", text)
        .replace("  ", " ")
        .strip()
    )


# -- what is stored, and what of it is stale ---------------------------------------------------------------


def code_of(files: Iterable[str]) -> dict[str, str]:
    """Return the hash of each file, by its path; `COMPILED` is that of what these files need."""
    files = list(files)
    return {
        file: compiled_digest(compiled_roots(files)) if file == COMPILED else digest(file) for file in files
    }


def overall(code: dict[str, str]) -> str:
    """Return one hash of all hashes."""
    return _hash(json.dumps(code, sort_keys=True))


def write_code(path: Path, code: dict[str, str]) -> None:
    """Write a line for each file: hash and path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(f"{value}  {file}\n" for file, value in sorted(code.items())), encoding="utf-8")


def read_code(path: Path) -> dict[str, str] | None:
    """Read the file of `write_code`; None if there is none."""
    if not path.is_file():
        return None
    pairs = (line.split("  ", 1) for line in path.read_text(encoding="utf-8").splitlines())
    return {file: value for value, file in pairs}


def changed(path: Path, code: str | None) -> list[str]:
    """Return files that changed since a result was measured; a reason if unknown.

    `code` is the overall hash of the result. A moved file counts as unchanged.
    """
    before = read_code(path)
    if before is None or code is None:
        return ["(no record of the code that was measured)"]
    if overall(before) != code:
        return [f"(the record of the code, {path.name}, is of another run)"]
    unread = NOT_MEASURED | unread_pages(before)
    measured = {file: value for file, value in before.items() if file not in unread}
    now = code_of(measured)
    candidates = [file for file, value in measured.items() if now[file] != value]
    present = _all_digests() if candidates else frozenset()
    return [file for file in candidates if before[file] not in present]


@cache
def _all_digests() -> frozenset[str]:
    """Return the hashes of all files that can be measured, in any folder."""
    suffixes = (".py", ".toml", ".json", ".html", ".c", ".h")
    found = (path for folder in FOLDERS for path in (ROOT / folder).rglob("*") if path.suffix in suffixes)
    return frozenset(digest(path.relative_to(ROOT).as_posix()) for path in found)


# -- the run -----------------------------------------------------------------------------------------------


class Run:
    """Commit, load and duration of a run that starts now."""

    def __init__(self) -> None:
        self._load, self._wall, self._cpu = os.getloadavg()[0], time.monotonic(), _processor_s()

    def summary(self) -> dict[str, Any]:
        """Return commit, load and duration.

        "dirty" is whether the tree differed from the commit; "load" is that of a minute, before and after.
        """
        return {
            "commit": _git("rev-parse", "--short=12", "HEAD") or "unknown",
            "dirty": bool(_git("status", "--porcelain", "--", ".", ":!bench/results")),
            "load": [round(self._load, 2), round(os.getloadavg()[0], 2)],
            "seconds": round(time.monotonic() - self._wall, 1),
            "processor_seconds": round(_processor_s() - self._cpu, 1),
        }


def _processor_s() -> float:
    """Return the processor seconds of this process and its finished children."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)


def _git(*arguments: str) -> str:
    try:
        done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    return done.stdout.strip()
