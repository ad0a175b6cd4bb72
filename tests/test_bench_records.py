"""Records of benchmarks: the measured code, exact figures of quick runs, and the result of each script."""

from __future__ import annotations

import importlib
import subprocess
import sys
import tomllib
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import pytest

BENCH = Path(__file__).resolve().parents[1] / "bench"


@pytest.fixture(autouse=True)
def bench_on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Modules of bench/ import each other by name."""
    monkeypatch.setattr(sys, "path", [str(BENCH), *sys.path])


@pytest.fixture
def provenance() -> Any:
    return importlib.import_module("provenance")


@pytest.fixture
def machine() -> Any:
    return importlib.import_module("machine")


CODE = 'def f(a, b=2):\n    """Says."""\n    # why\n    return a + b\n\n\ndef bars(x):\n    return 1\n'


@pytest.mark.parametrize(
    "same",
    [
        CODE.replace('"""Says."""', '"""Says more."""'),
        CODE.replace("    # why\n", ""),
        CODE.replace("(a, b=2)", "(\n    a,\n    b=2,\n)"),
        "\n\n" + CODE,
    ],
)
def test_comments_docstrings_and_layout_change_no_hash(provenance: Any, same: str) -> None:
    assert same != CODE
    assert provenance.python_meaning(same) == provenance.python_meaning(CODE)


@pytest.mark.parametrize(
    ("old", "new"), [("a + b", "a - b"), ("b=2", "b=3"), ("return a", "return -a"), ("f(", "g(")]
)
def test_a_change_of_the_code_changes_the_hash(provenance: Any, old: str, new: str) -> None:
    assert provenance.python_meaning(CODE.replace(old, new)) != provenance.python_meaning(CODE)


def test_bars_count_outside_of_benchmarks_only(provenance: Any) -> None:
    other = CODE.replace("return 1", "return 2")
    assert provenance.python_meaning(other) != provenance.python_meaning(CODE)
    assert provenance.python_meaning(other, is_bench=True) == provenance.python_meaning(CODE, is_bench=True)


def test_c_by_its_tokens(provenance: Any) -> None:
    code = 'int a = 1; // one\nchar *s = "// no comment";\n'
    assert provenance.c_meaning(code) == provenance.c_meaning(
        'int a = 1; /* 1 */\n\n  char *s = "// no comment";'
    )
    assert provenance.c_meaning(code) != provenance.c_meaning(code.replace("no comment", "a comment"))
    assert provenance.c_meaning(code) != provenance.c_meaning(code.replace("1;", "2;"))


def test_a_built_page_counts_where_a_module_names_it(
    provenance: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(provenance, "ROOT", tmp_path)
    (tmp_path / "a.py").write_text('page = read("web/page.html")\n')
    files = ["a.py", "web/page.html", "web/map.html", "missing.py", "device.toml"]
    assert provenance.unread_pages(files) == {"web/map.html"}
    assert provenance.unread_pages(files[1:]) == {"web/page.html", "web/map.html"}


def test_changed_files_are_named(provenance: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provenance, "ROOT", tmp_path)
    for name in ("a.py", "b.py"):
        (tmp_path / name).write_text(CODE)
    provenance.digest.cache_clear()
    code = provenance.code_of(["a.py", "b.py"])
    record = tmp_path / "code" / "it.txt"
    provenance.write_code(record, code)
    assert provenance.read_code(record) == code
    assert provenance.changed(record, provenance.overall(code)) == []
    (tmp_path / "a.py").write_text(CODE.replace("why", "because"))
    (tmp_path / "b.py").write_text(CODE.replace("a + b", "a * b"))
    provenance.digest.cache_clear()
    assert provenance.changed(record, provenance.overall(code)) == ["b.py"]
    (tmp_path / "a.py").unlink()
    provenance.digest.cache_clear()
    assert provenance.changed(record, provenance.overall(code)) == ["a.py", "b.py"]
    moved = tmp_path / "src" / "package" / "c.py"
    moved.parent.mkdir(parents=True)
    moved.write_text(CODE)
    provenance._all_digests.cache_clear()
    assert provenance.changed(record, provenance.overall(code)) == []
    with_version = {**code, "src/touchfield/_version.py": "0" * 16}
    provenance.write_code(record, with_version)
    assert provenance.changed(record, provenance.overall(with_version)) == []  # of a release
    assert "another run" in provenance.changed(record, "0" * 16)[0]
    assert "no record" in provenance.changed(tmp_path / "none.txt", "0" * 16)[0]
    provenance.digest.cache_clear()
    provenance._all_digests.cache_clear()


def test_imports_are_hashed_by_names_and_not_modules(provenance: Any) -> None:
    code = "from touchfield.tasks.view import scene, page as shown\n"
    moved = "from touchfield.viewer import page as shown\nfrom touchfield.tasks import scene\n"
    assert provenance.python_meaning(moved) == provenance.python_meaning(code)
    assert provenance.python_meaning(code.replace("scene", "scenes")) != provenance.python_meaning(code)


def test_a_trace_lists_loaded_modules_and_the_files_of_their_packages(tmp_path: Path) -> None:
    script = tmp_path / "traced.py"
    script.write_text(
        f"import subprocess, sys\nsys.path.insert(0, {str(BENCH)!r})\nimport provenance\ntrace = "
        "provenance.Trace()\n"
        "subprocess.run([sys.executable, '-c', 'import touchfield.devices, touchfield.filters.fir'], "
        "check=True)\n"
        "print(*trace.files(['c/*.h']), sep='\\n')\n"
    )
    files = subprocess.run(
        [sys.executable, script], check=True, capture_output=True, text=True
    ).stdout.split()
    assert {"src/touchfield/filters/fir.py", "src/touchfield/devices/profiles/omega.3.toml", "c/touch.h"} <= {
        *files
    }
    assert "bench/provenance.py" not in files and "src/touchfield/codec/touch/encoder.py" not in files


def test_exact_figures_are_bytes_and_errors_and_no_times(machine: Any) -> None:
    figures = {
        "object": {"file_bytes": 19515, "encode_s": 1.5, "peak_mb": 90.0, "nmse_db": -20.5},
        "rows": [{"name": "a", "supported_voxels": 7, "worst_ms": 3.0}, {"voxels": 8}],
        "peers": {"zpaq_bytes": 3},
        "absent": [],
        "none_db": None,
    }
    exact = {
        "object/file_bytes": 19515,
        "object/nmse_db": -20.5,
        "rows/a/supported_voxels": 7,
        "rows/1/voxels": 8,
    }
    assert machine.exact_figures(figures) == exact
    assert machine.exact_figures(figures, ["rows/*"]) == {k: v for k, v in exact.items() if k[0] == "o"}


def test_a_byte_count_that_changed_fails_a_quick_run(
    machine: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(machine, "QUICK", tmp_path / "quick")
    monkeypatch.setattr(
        machine, "SHARED", tmp_path
    )  # the folder of inputs exists, so no figure may be absent
    monkeypatch.setenv(machine.STORE_QUICK, "1")
    machine.check_quick("it", {"file_bytes": 82669, "least_db": -20.0})
    monkeypatch.delenv(machine.STORE_QUICK)
    machine.check_quick("it", {"file_bytes": 82670, "least_db": -20.001})
    for figures in ({"file_bytes": 19515, "least_db": -20.0}, {"least_db": -20.0}):
        with pytest.raises(SystemExit, match="file_bytes"):
            machine.check_quick("it", figures)


def test_a_quick_run_may_leave_out_only_figures_that_say_why(
    machine: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(machine, "QUICK", tmp_path / "quick")
    monkeypatch.setattr(machine, "SHARED", tmp_path)
    monkeypatch.setenv(machine.STORE_QUICK, "1")
    machine.check_quick("it", {"movie": {"touch bytes": 3006}, "map": {"a.svg": {"map bytes": 29529}}})
    monkeypatch.delenv(machine.STORE_QUICK)
    reason = machine.not_measured("ffmpeg is missing")
    machine.check_quick("it", {"movie": reason, "map": {"a.svg": {"map bytes": reason}}})
    with pytest.raises(SystemExit, match="map bytes") as raised:
        machine.check_quick("it", {"movie": reason, "map": {"a.svg": {}}})
    assert "touch bytes" not in str(raised.value)
    with pytest.raises(SystemExit, match="touch bytes"):
        machine.check_quick("it", {"movie": "another text", "map": {"a.svg": {"map bytes": 29529}}})


def test_each_bar_that_is_not_met_says_why(machine: Any) -> None:
    results = {path.stem: machine.stored(path.stem)["bars"] for path in machine.RESULTS.glob("*.json")}
    unmet = [(name, bar) for name, bars in results.items() for bar in bars if not bar["met"]]
    assert unmet and not [f"{name}: {bar['bar']}" for name, bar in unmet if not machine.reason(name, bar)]
    line = machine.bar_line(unmet[0][1], machine.reason(*unmet[0]))
    assert line.count("\n") == 1 and machine.reason(*unmet[0]) in line
    names = tomllib.loads(machine.REASONS.read_text(encoding="utf-8"))
    unused = [
        f"{name}: {pattern}"
        for name in names
        for pattern in names[name]
        if not any(fnmatch(bar["bar"], pattern) for bar in results[name])
    ]
    assert not unused


@pytest.mark.parametrize(
    ("code", "verdict", "is_failure"),
    [
        ("pass", "finished", False),
        ("import sys; sys.exit(77)", "left out", False),
        ("import sys; sys.exit(1)", "failed, status 1", True),
        ("import time; time.sleep(60)", "exceeded 1 s", True),
    ],
)
def test_the_verdict_on_a_script(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, verdict: str, is_failure: bool
) -> None:
    run_all = importlib.import_module("run_all")
    monkeypatch.setattr(run_all, "HERE", tmp_path)
    (tmp_path / "bench_it.py").write_text(code)
    for is_verbose in (True, False):
        outcome = (
            run_all.run("it", True, 1.0, is_verbose)
            if "sleep" in code
            else run_all.run("it", True, 30.0, is_verbose)
        )
        assert (outcome.verdict, outcome.is_failure) == (verdict, is_failure)
        if "sleep" in code:
            break
    assert run_all.run_each(["it"], True, 1.0 if "sleep" in code else 30.0, 2) is not is_failure


def test_the_compiled_module_counts_by_what_the_functions_in_use_need(
    provenance: Any, tmp_path: Path
) -> None:
    """Its binary differs between compilers, and a change of the renderer is none of the coder."""
    coder, player = tmp_path / "coder.py", tmp_path / "player.py"
    coder.write_text("native.encode_segment(frames)\n")
    player.write_text("def play():\n    return native.cycle(memory)\n")
    of_coder, of_both = (
        {name for declaration in needed_by(provenance, files) for name in declaration.names}
        for files in ([coder], [coder, player])
    )
    assert of_coder >= {"native_encode_segment", "touch_code_residual", "TOUCH_CORRUPT", "touch_arena"}
    assert not of_coder & {"touch_receiver", "touch_proxy", "touch_force_at"}
    assert of_both >= of_coder | {
        "touch_receiver_tick",
        "touch_contact_force",
        "touch_proxy",
        "TOUCH_PROXY_AWAY",
    }
    package = BENCH.parent / "src" / "touchfield"
    assert not any(path.name.startswith("_native") for path in provenance._data_of(package))


def needed_by(provenance: Any, files: list[Path]) -> list[Any]:
    roots = provenance.compiled_roots(map(str, files))
    assert len(roots) >= len(files)
    return list(provenance.c_declarations.needed(provenance._native_declarations(), roots))


def test_a_program_in_c_counts_by_what_it_names(provenance: Any, tmp_path: Path) -> None:
    program = tmp_path / "program.c"
    program.write_text("/* touch_contact_force */ int main(void) { return (int)touch_force_at(t, p).x; }\n")
    names = {name for found in needed_by(provenance, [program]) for name in found.names}
    assert {"touch_force_at", "touch_cell_force", "touch_vector"} <= names
    assert not names & {"touch_contact_force", "native_force_at"}


def test_every_function_of_the_compiled_module_has_a_source(provenance: Any) -> None:
    from touchfield.compute.native import native

    listed = [name for name, _ in provenance.native_functions()]
    assert sorted(listed) == sorted(name for name in dir(native) if not name.startswith("_"))
    known = provenance._native_declarations()
    assert not [function for _, function in provenance.native_functions() if function not in known]


HEADER = """
#ifndef SHAPES_H
#define SHAPES_H
#include <math.h>
#ifdef __cplusplus
extern "C" {
#endif
typedef struct { /* { of a ball } */
    double radius_m;
} ball;
enum { SMALL = 1, LARGE };
#define TWICE(x) \\
    (HALF * 4 * (x))
#define HALF 0.5
static const double sizes[2] = {1.0, LARGE};
static const struct { const char *name; } table[] = {{"ball; }"}};
static inline double area(const ball *b);
static inline __attribute__((unused)) double ratio(double a, double b) {
    double table_of[] = {a};
    if (b > 0.0) { return table_of[0] / b; }
    return 0.0;
}
#if HAS_LARGE
static inline double area(const ball *b) { return ratio(b->radius_m, sizes[0]); }
#else
static inline double area(const ball *b) { return b->radius_m; }
#endif
static inline double other(double x) { return TWICE(x) + sizeof table; }
#ifdef __cplusplus
}
#endif
#endif
"""


def test_declarations_of_c_by_their_names() -> None:
    c_declarations = importlib.import_module("c_declarations")
    known = c_declarations.by_name([HEADER])
    assert known.keys() == {
        *("ball", "SMALL", "LARGE", "TWICE", "HALF", "sizes", "table", "area", "ratio", "other")
    }

    def needs(root: str) -> set[str]:
        return {name for found in c_declarations.needed(known, [root]) for name in found.names}

    assert needs("ratio") == {"ratio"}
    assert needs("area") == {"area", "ball", "ratio", "sizes", "SMALL", "LARGE"}
    assert needs("other") == {"other", "TWICE", "HALF", "table"}
    body = "static inline double area(const ball *b)"
    assert {found.text for found in known["area"]} == {
        f"{body};",
        f"#if HAS_LARGE {body} {{ return ratio(b->radius_m, sizes[0]); }}",
        f"#if HAS_LARGE #else {body} {{ return b->radius_m; }}",
    }


def test_a_declaration_in_another_header_or_layout_is_the_same() -> None:
    c_declarations = importlib.import_module("c_declarations")
    moved = HEADER.replace("SHAPES_H", "OTHER_H").replace("of a ball", "of balls").replace("    ", "\t")
    assert {*c_declarations.declarations(moved)} == {*c_declarations.declarations(HEADER)}
    changed = c_declarations.by_name([HEADER.replace("4 *", "3 *")])
    differing = {name for name, found in changed.items() if found != c_declarations.by_name([HEADER])[name]}
    assert differing == {"TWICE"}
