"""Every option of every command reaches its task with the given value, and changes nothing else.

The commands run with their tasks replaced by recorders. One run has the defaults, the other one option more;
the two records must differ exactly in the leaf that `option_tables.EXPECTED` names: an option that is
ignored, swapped with another or converted to another unit fails.
"""

from __future__ import annotations

import inspect
import io
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
import typer.main

from option_tables import ARGUMENTS, CALLED, EXPECTED, MISSING, STUB, Case
from touchfield.cli.main import _exit_code, load_commands
from touchfield.cli.output import Answer

GROUP: Any = typer.main.get_command(load_commands())


class Stub(MagicMock):
    """A task's result: accepts every call and has a printable text."""

    tolist = property(lambda self: self.no_such_attribute_here)


def leaves(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    """The parts of a value with their paths: dataclass fields, mapping items, tuples of dataclasses."""
    if isinstance(value, Path):
        value = str(value)
    if isinstance(value, MagicMock | np.ndarray):
        yield path, str(value.tolist()) if isinstance(value, np.ndarray) else STUB
    elif is_dataclass(value):
        for item in fields(value):
            yield from leaves(getattr(value, item.name), f"{path}.{item.name}")
    elif isinstance(value, dict):
        for key, part in value.items():
            yield from leaves(part, f"{path}.{key}")
    elif isinstance(value, tuple | list) and "<Stub" in repr(value):
        yield path, STUB
    elif isinstance(value, tuple | list) and any(is_dataclass(item) for item in value):
        for index, part in enumerate(value):
            yield from leaves(part, f"{path}.{index}")
    else:
        yield path, tuple(value) if isinstance(value, list) else value


class Recorder:
    """The calls of a run: the arguments of each function, and the methods called on its result."""

    METHODS = ("end", "draw", "save", "open", "write_log", "write_text", "follow", "supported_voxels", "show")

    def __init__(self) -> None:
        self.arguments: dict[str, dict[str, Any]] = {}
        self.results: dict[str, Any] = {}

    def replacement(self, original: Any, name: str, result: Any = None) -> Any:
        signature = inspect.signature(original)

        def recorded(*args: Any, **kwargs: Any) -> Any:
            bound = signature.bind(*args, **kwargs)
            bound.apply_defaults()
            self.arguments[name] = dict(bound.arguments)
            self.results[name] = Stub() if result is None else result
            if isinstance(self.results[name], Stub):
                self.results[name].summary.return_value = {}
                self.results[name].notes = ()
            return self.results[name]

        return recorded

    def record(self) -> dict[str, Any]:
        """All leaves by their paths; callables in arguments are left out."""
        found: dict[str, Any] = {}
        for name, arguments in self.arguments.items():
            found[name] = CALLED
            for key, value in arguments.items():
                is_callback = callable(value) and not isinstance(value, MagicMock)
                if not (is_callback or isinstance(value, Answer)):
                    found.update(leaves(value, f"{name}.{key}"))
            for call in getattr(self.results[name], "mock_calls", ()):
                method = call[0].rpartition(".")[2]
                if method in self.METHODS:
                    for index, value in enumerate(call[1]):
                        found.update(leaves(value, f"{name}().{method}.{index}"))
                    found.setdefault(f"{name}().{method}", CALLED)
        return found


def changes(before: dict[str, Any], after: dict[str, Any]) -> dict[str, Any]:
    """The leaves that differ, with their new values."""
    both = {key: (before.get(key, MISSING), after.get(key, MISSING)) for key in {**before, **after}}
    return {key: new for key, (old, new) in both.items() if repr(old) != repr(new)}


def is_at(path: str, leaf: str) -> bool:
    return path == leaf or path.endswith(leaf if leaf.startswith(".") else f".{leaf}")


def is_explained(path: str, expected: dict[str, Any]) -> bool:
    """True for a leaf that `expected` names, or one of a call whose presence it names."""
    parents = [name for name, value in expected.items() if value in (CALLED, MISSING)]
    return any(is_at(path, leaf) for leaf in expected) or any(path.startswith(f"{name}.") for name in parents)


TASKS = {
    "encode": (
        "pipeline:encode",
        "pipeline:encode_to_target",
        "pipeline:compare_prepared",
        "cli.encode:computing",
        "cli.encode:executor_of",
    ),
    "filter": (
        "pipeline:encode",
        "pipeline:prepare",
        "pipeline:write_field",
        "pipeline:filter_report",
        "pipeline:draw_filtered",
        "cli.encode:executor_of",
    ),
    "field": ("pipeline:prepare", "tasks.view:draw_preview", "pipeline:write_field", "cli.encode:computing"),
    "plan": ("tasks.plan:plan", "cli.encode:executor_of"),
    "decode": ("network.opening:open_stream", "pipeline.decoding:write_field"),
    "export": ("tasks.exchange:export",),
    "import": ("tasks.exchange:import_effect",),
    "map": ("tasks.map:make_map",),
    "watch": ("tasks.watch:watch",),
    "edit": ("tasks.editing:edit",),
    "splice": ("tasks.editing:splice",),
    "resample": ("tasks.editing:resample_file",),
    "lod": ("tasks.editing:levels_of_detail",),
    "partition": ("tasks.matching:read_medium", "pipeline.partition:partition_workspace"),
    "texture": (
        "tasks.texture:texture_of_files",
        "tasks.texture:merge_materials",
        "tasks.texture:store_materials",
        "render.material:write_table",
        "viewer.plots:draw_textures",
    ),
    "deform": ("tasks.deformation:tracks_of",),
    "info": ("network.opening:open_stream",),
    "view": ("tasks.view:view", "tasks.rerun_scene:view_in_rerun"),
    "compare": ("pipeline:compare",),
    "play": (
        "tasks.play:play",
        "tasks.play:check_play",
        "network.bridge:Bridge",
        "cli.play:read_materials",
        "cli.play:read_deformation",
    ),
    "guide": ("tasks.guide:guide", "tasks.guide_log:Rows"),
    "serve": ("network.server:serve",),
    "live": (
        "tasks.live:open_sender",
        "tasks.live:broadcast",
        "tasks.live:coarse_layer",
        "network.live_server:LiveServer",
        "network.udp:UdpSender",
        "network.live:write_message",
    ),
    "mux": ("network.mux:mux",),
    "demux": ("network.demux:demux",),
    "measure": ("tasks.measure:measure_medium",),
    "reduce": ("tasks.reduction:reduce_medium",),
    "index": ("tasks.library:index_folder", "cli.library:executor_of"),
    "search": ("tasks.library:search",),
    "similar": ("tasks.library:similar",),
    "study": ("tasks.study:run_session",),
    "correlate": ("tasks.library:correlate",),
    "points": ("tasks.reduction:fewest_points", "tasks.reduction:next_points"),
    "demo": ("cli.demo:run_demo",),
    "doctor": ("tasks.setup:examine",),
}
"""The recorded functions of each command, as "module:name"."""

RESULTS: dict[str, Any] = {
    "play": Stub(is_starved=False, error=None),
    "guide": ({}, ()),
    "read_medium": SimpleNamespace(medium=SimpleNamespace(grid=SimpleNamespace(shape=(64, 32, 16)))),
    "open_sender": (Stub(name="fine"), Stub(name="fine sender")),
    "coarse_layer": (Stub(name="coarse"), Stub(name="coarse sender")),
    "check_play": {"can_play": True},
    "texture_of_files": (Stub(name="oak"), ()),
    "examine": {},
}


def run(
    command: str, arguments: list[str], folder: Path, monkeypatch: pytest.MonkeyPatch, code: int = 0
) -> dict[str, Any]:
    """The record of a command that must end with exit code `code`."""
    recorder = Recorder()
    for result in RESULTS.values():
        if isinstance(result, MagicMock):
            result.reset_mock()
    with monkeypatch.context() as patch:
        for task in TASKS.get(command, ()):
            module, _, name = task.partition(":")
            holder = import_module(f"touchfield.{module}")
            patch.setattr(holder, name, recorder.replacement(getattr(holder, name), name, RESULTS.get(name)))
        patch.setattr(Answer, "show", recorder.replacement(Answer.show, "show"))
        patch.chdir(folder)
        assert _exit_code([command, *arguments]) == code, (command, arguments)
    return recorder.record()


def output(command: str, arguments: list[str], code: int = 0) -> str:
    """Everything that a command prints; it must end with exit code `code`."""
    text = io.StringIO()
    with redirect_stdout(text), redirect_stderr(text):
        assert _exit_code([command, *arguments]) == code
    return text.getvalue()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The folder that the arguments name, with the files that some commands look for before their task."""
    (tmp_path / "in.touch").write_bytes(b"")
    for name in ("out.json", "new.json"):
        (tmp_path / name).write_text("{}")
    return tmp_path


def options_of(command: Any) -> dict[str, Any]:
    """The options of a command by their names, without --help."""
    options = [
        option for option in command.params if option.param_type_name == "option" and option.name != "help"
    ]
    return {option.opts[-1].removeprefix("--"): option for option in options}


def test_table_names_every_option_of_every_command() -> None:
    options = {name: set(options_of(command)) for name, command in GROUP.commands.items()}
    assert options == {name: set(cases) for name, cases in EXPECTED.items()}
    assert sum(map(len, options.values())) > 600
    assert {*TASKS, "devices", "sources", "data", "warmup"} == set(options)


@pytest.mark.parametrize("command", [name for name, cases in EXPECTED.items() if cases])
def test_every_option_reaches_its_task(command: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    default_records: dict[str, dict[str, Any]] = {}
    faults = [
        check(command, name, case, default_records, folder, monkeypatch)
        for name, case in EXPECTED[command].items()
    ]
    assert not [fault for fault in faults if fault], "\n".join(filter(None, faults))


def check(
    command: str,
    name: str,
    case: Case,
    default_records: dict[str, dict[str, Any]],
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> str:
    """The fault of an option, or an empty text; `default_records` caches the runs without it."""

    def filled(value: Any) -> Any:
        return value.format(tmp=folder) if isinstance(value, str) else value

    base = filled(f"{ARGUMENTS[command]} {case.beside}").split()
    arguments = [*base, f"--{name}", *([] if case.text is None else [filled(case.text)])]
    if (case.text is None) != options_of(GROUP.commands[command])[name].is_flag:
        return f"{command} --{name}: a flag has no value, all others have one"
    if case.refused:
        return "" if case.refused in output(command, arguments, 2) else f"{command} --{name} is taken"
    if case.printed:
        return (
            ""
            if case.printed in output(command, arguments) and case.printed not in output(command, base)
            else f"{command} --{name}"
        )
    if case.beside not in default_records:
        default_records[case.beside] = run(command, base, folder, monkeypatch)
    changed = changes(default_records[case.beside], run(command, arguments, folder, monkeypatch))
    for leaf, value in case.leaves.items():
        if [new for path, new in changed.items() if is_at(path, leaf)] != [filled(value)]:
            return f"{command} --{name}: {leaf} is not {value!r}, but {changed}"
    stray = {path: new for path, new in changed.items() if not is_explained(path, case.leaves)}
    return f"{command} --{name} changes more than {case.leaves}: {stray}" if stray else ""


def test_live_stream_sends_its_end_to_receivers(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    assert run("live", ["scene.stl"], folder, monkeypatch)["LiveServer().end"] == CALLED
    servers: list[Stub] = []
    monkeypatch.setattr(
        "touchfield.network.live_server.LiveServer", lambda *_: servers.append(Stub()) or servers[0]
    )
    monkeypatch.setattr("touchfield.tasks.live.open_sender", lambda *_: RESULTS["open_sender"])
    monkeypatch.setattr("touchfield.tasks.live.broadcast", interrupt)
    assert _exit_code(["live", "scene.stl"]) == 1
    assert servers[0].__enter__.return_value.end.called, "also where it is interrupted"
