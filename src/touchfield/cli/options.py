"""The options of the commands, once: how the scene is read, felt, mapped, filtered and coded.

Each is one row; `asks` gives a command the rows it takes, so that two commands cannot drift apart.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import fields
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from touchfield.codec.registry import field_coders
from touchfield.errors import InvalidArgument
from touchfield.filters.registry import field_filters
from touchfield.job import EncodeSpec, Target
from touchfield.sources.options import SourceOptions

DeviceCompute = Annotated[
    str, typer.Option("--device-compute", help="Where forces are computed: cpu, cuda (extra cuda), or auto.")
]
"""Of a command that makes fields of a scene."""

Workers = Annotated[
    str | None,
    typer.Option("--workers", help="Who does the work: processes:N of this machine, or dask:ADDRESS, a scheduler."),
]

Row = tuple[str, Any, Any, str]
"""Name, type, default, help."""

FIRST: Final = (
    "device", "nw", "frames", "mapping", "stiffness-n-per-m", "thickness-m", "k", "f0-n", "mode", "target-bytes",
)  # fmt: skip
"""The options that most people need."""

PANELS: Final = {
    "Device and lattice": (
        "nominal", "representation", "fit-frames", "oversample", "pool", "cutoff",
    ),
    "Address": ("host", "port", "token", "open", "cors"),
    "Force": (
        "law", "band-m", "surface-damping-n-s-per-m", "vibration", "friction", "damping-n-s-per-m",
    ),
}  # fmt: skip
"""Of the other rows those that are about neither the scene nor a coder."""

ALLOW_OUTSIDE = "Models and scene files may name files outside their own folder."

SCENE: tuple[Row, ...] = (
    ("device", str, "phantom-omni", "Device profile (see `touchfield devices`), or a TOML file of your own."),
    ("nw", int, 7, "2^nw samples per axis of the device's workspace, 3 to 10."),
    ("nominal", bool, False, "Use the device's nominal lattice in place of 2^nw."),
    ("representation", str, "auto", "voxel, object (fields and pose tracks), or auto."),
    ("frames", str | None, None, "Frames to take, START:STOP; also those that are fitted into the workspace."),
    ("fit-frames", str | None, None, "Frames to fit into the workspace, START:STOP, where others than --frames."),
    ("law", str, "penalty", "Force law: penalty, proximity, magnetic, or a sum such as penalty+proximity."),
    ("stiffness-n-per-m", float, 500.0, "Stiffness K, newtons per metre that the hand moves."),
    ("thickness-m", float | None, None, "Wall behind the surface, metres that the hand moves; inf is solid."),
    ("band-m", float, 0.004, "Reach of the proximity and magnetic laws, metres that the hand moves."),
    ("surface-damping-n-s-per-m", float, 0.0, "Drag of a moving surface: b times its velocity is added."),
    ("mapping", str, "fit", "Scene to workspace: fit (5 % of room is left), fill, crop, or a factor such as 0.05."),
    ("oversample", int, 2, "Samples per axis and device sample before the anti-alias low-pass."),
    ("pool", str, "max", "Depth pooling of an actuator array: max or mean."),
    ("cutoff", str, "nyquist", "Low-pass of an actuator array: nyquist = 1/(2d), or literal = 2/d."),
    ("as", str | None, None, "Kind of the source, where it is not recognised."),
    ("depth-scale", float | None, None, "Stored depth units in a metre."),
    ("intrinsics", str | None, None, "Camera: fx,fy,cx,cy in pixels, or a file."),
    ("poses", str | None, None, "Depth sequences: camera poses, a file or a folder; found where they lie beside it."),
    ("frame", str, "world", "Depth sequences: world (poses are used) or camera."),
    ("world", str, "fused", "Depth sequences: fused (one world of all frames), causal (of those so far) or frames."),
    ("reading", str, "camera", "Depth maps: camera (metric, a wall) or height (solid, as in the paper)."),
    ("shell", str, "auto", "Open meshes: one or two sided."),
    ("holes", str, "small", "Holes of meshes: close, leave, or small (close those below 5 % of the area)."),
    ("cell-size-m", float | None, None, "Height maps: metres between samples."),
    ("height-scale", float | None, None, "Height maps: metres of one stored unit."),
    ("exaggeration", float, 1.0, "Height maps: factor on heights."),
    ("unit-m", float | None, None, "Meshes: metres of one unit."),
    ("rate-hz", float | None, None, "Frames a second of the medium; depth frames are interpolated in time."),
    ("seconds", float | None, None, "Simulations: their duration."),
    ("source-rate-hz", float | None, None, "Frames a second of the source, where it does not say."),
    ("interpolation", str, "linear", "Between depth frames: linear or nearest."),
    ("animation", str | None, None, "Animated models: name or number of the animation."),
    ("relative-depth", str | None, None, "Pictures and videos: the relative depth beside them."),
    ("near-m", float | None, None, "Relative depth: metres of its nearest value."),
    ("far-m", float | None, None, "Relative depth: metres of its farthest value."),
    ("segment", str | None, None, "Depth sequences as objects: the rule of segmentation."),
    ("baseline-m", float | None, None, "Disparity maps: distance between the cameras."),
    ("disparity-offset-px", float | None, None, "Disparity maps: offset of the principal points."),
    ("allow-outside", bool, False, ALLOW_OUTSIDE),
)


def _coder_rows() -> tuple[Row, ...]:
    """One option for each that a coder takes; where several take one, its help tells what it is to each."""
    words = [word for one in field_coders().values() for word in one.makers]
    options: dict[str, tuple[type, list[str]]] = {}
    for one in field_coders().values():
        for option in one.options:
            options.setdefault(option.key, (option.kind, []))[1].append(f"{one.name}: {option.help}")
    rows: list[Row] = [("coder", str, words[0], f"{', '.join(words)} (literal: every part as printed in the paper).")]
    for key, (kind, helps) in options.items():
        asked, default = (bool, False) if kind is bool else (kind | None, None)
        rows.append((key.replace("_", "-"), asked, default, " ".join(helps)))
    return tuple(rows)


CODER: tuple[Row, ...] = _coder_rows()

BESIDE: tuple[Row, ...] = (
    ("vibration", str | None, None, "Beside the force: gain=0.1,frequency=150, or rising: frequency=80..250."),
    ("friction", float | None, None, "Friction coefficient mu, which the receiver renders; default: the source's."),
    ("damping-n-s-per-m", float | None, None, "Damping b, which the receiver renders; default: the source's."),
)

TARGET: tuple[Row, ...] = (
    ("target-nmse-db", float | None, None, "touch: the NMSE to reach, dB, such as -25; mode nmse unless asked."),
    ("target-bytes", int | None, None, "touch: the size to reach: k (mode nmse: the step) is raised until it fits."),
)


def address_rows(port: int, verb: str) -> tuple[Row, ...]:
    """The options of a server: where it listens, and who may receive."""
    return (
        ("host", str, "127.0.0.1", "Address to listen at; beyond this machine only with a token."),
        ("port", int, port, "Port; 0: a free one."),
        ("token", str | None, None, "Word that a receiver must bring: ...?token=WORD."),
        ("open", bool, False, f"Let anyone {verb} who reaches the address."),
        ("cors", list[str] | None, None, "Origin of web pages that may read, such as https://example.org; or *."),
    )


def filter_rows() -> tuple[Row, ...]:
    """One option for each registered haptic filter; their order on the command line is their order of work."""
    return tuple((name, list[str] | None, None, kind.summary) for name, kind in field_filters().items())


def asks(
    *groups: tuple[Row, ...], panel: Callable[[str], str | None] | None = None
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Give a command the options of `groups`; it gets `asked`. `panel` of a name is its group in the help."""
    group = panel or _panel

    def give(command: Callable[..., Any]) -> Callable[..., Any]:
        own = [p for p in inspect.signature(command, eval_str=True).parameters.values() if p.name != "asked"]
        rows = sorted((row for group in groups for row in group), key=lambda row: row[0] not in FIRST)
        more = []
        for name, kind, default, text in rows:
            words = text.replace("[", r"\[")  # what stands in brackets is no markup
            option = typer.Option(f"--{name}", help=words, rich_help_panel=group(name))
            key = "as_" if name == "as" else name.replace("-", "_")
            more.append(
                inspect.Parameter(
                    key, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, option]
                )
            )
        names = {p.name for p in more}

        @wraps(command)
        def call(**given: Any) -> Any:
            order = given.pop("context").params  # as on the command line; what is not there follows
            asked = {name.rstrip("_"): given.pop(name) for name in order if name in names}
            return command(**given, asked=asked)

        own.append(inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context))
        kept = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in own]
        call.__signature__ = inspect.Signature([*kept, *more])  # type: ignore[attr-defined]
        call.__annotations__ = {p.name: p.annotation for p in (*kept, *more)}
        return call

    return give


def _panel(name: str) -> str:
    """The group of an option in the help."""
    if name in FIRST:
        return "What most people need"
    for panel, names in PANELS.items():
        if name in names:
            return panel
    if name in field_filters():
        return "Haptic filters"
    key = name.replace("-", "_")
    coders = [one.name for one in field_coders().values() if key in {option.key for option in one.options}]
    if coders == ["paper"]:
        return "The paper's coder"
    if coders or name == "coder" or name.startswith("target"):
        return "Coder"
    return "Scene"


def frames_of(option: str, text: str | None) -> tuple[int, int | None] | None:
    """The frames of START:STOP, or of the number of one."""
    if text is None:
        return None
    start, colon, stop = text.partition(":")
    try:
        first = int(start or 0)
        last = int(stop) if stop else (None if colon else first + 1)
    except ValueError:
        raise InvalidArgument(option, repr(text), "START:STOP, such as 0:24") from None
    if first < 0 or (last is not None and last <= first):
        raise InvalidArgument(option, repr(text), "START below STOP, neither negative")
    return first, last


def numbers_of(option: str, text: str | None, counts: Sequence[int], expected: str, kind: type = float) -> Any:
    """The numbers between commas, as a tuple; there must be as many as one of `counts`."""
    try:
        numbers = tuple(kind(word) for word in (text or "").split(","))
    except ValueError:
        numbers = ()
    if len(numbers) not in counts:
        raise InvalidArgument(option, repr(text) if text else "nothing", expected)
    return numbers


def fields_of(spec: type[Any], asked: dict[str, Any]) -> dict[str, Any]:
    """The values of the fields of a spec; an option is called as its field is."""
    return {f.name: asked[f.name] for f in fields(spec) if f.name in asked}


def _coder(asked: dict[str, Any]) -> dict[str, Any]:
    """The coder and what is asked of it; an option of another coder is refused, not ignored."""
    word, coders = asked["coder"], field_coders().values()
    own = next((one for one in coders if word in one.makers), None)
    if own is None:
        raise InvalidArgument("--coder", repr(word), f"one of {', '.join(w for one in coders for w in one.makers)}")
    values = {key: value for key, value in asked.items() if value is not None and value is not False}
    taken = {option.key for option in own.options}
    for other in coders:
        for option in other.options:
            if option.key in values and option.key not in taken:
                said = f"--{option.key.replace('_', '-')} works with --coder {other.name}, not with {word}"
                raise InvalidArgument(said, mend="Take it out, or change the coder.")
    chosen = {key: values[key] for key in values if key in taken | set(own.hints)}
    return {"coder": own.name, own.name: own.makers[word](chosen)}


def encode_spec(asked: dict[str, Any]) -> EncodeSpec:
    """The options as the job takes them."""
    source = SourceOptions(kind=asked["as"], **fields_of(SourceOptions, asked))
    if source.intrinsics and Path(source.intrinsics).suffix and not Path(source.intrinsics).exists():
        looks_like_numbers = all(c in "0123456789.,+-eE " for c in source.intrinsics)
        if not looks_like_numbers:
            raise InvalidArgument("--intrinsics", repr(source.intrinsics), "fx,fy,cx,cy or a file that exists")
    as_given = {name: value for name, value in fields_of(EncodeSpec, asked).items() if name != "coder"}
    chain = []
    for name, words in ((key.replace("_", "-"), asked[key]) for key in asked):
        if name not in field_filters() or not words:
            continue
        if len(words) > 1:
            mend = "Filter twice: the .touch file of the first run may be the source of the second."
            raise InvalidArgument(f"--{name} can be given once, not {len(words)} times", mend=mend)
        chain.append((name, words[0]))
    as_given |= {
        "nw": None if asked["nominal"] else asked["nw"],
        "frames": frames_of("--frames", asked["frames"]),
        "fit_frames": frames_of("--fit-frames", asked["fit_frames"]),
        "filters": tuple(chain),
    }
    return EncodeSpec(**as_given, source=source, **(_coder(asked) if "coder" in asked else {}))


def coder_spec(asked: dict[str, Any]) -> EncodeSpec:
    """The coder's options alone, without a scene's."""
    return encode_spec({name.replace("-", "_"): default for name, _, default, _ in SCENE} | asked)


def target_of(asked: dict[str, Any]) -> Target | None:
    """The size or the error to reach, where one was asked for."""
    if asked["target_bytes"] is None and asked["target_nmse_db"] is None:
        return None
    return Target(asked["target_bytes"], asked["target_nmse_db"])


def workers_of(words: str | None) -> AbstractContextManager[Executor | None]:
    """The executor of --workers, for the length of a block; None where nobody asked for one."""
    if words is None:
        return nullcontext()
    from touchfield.job.executors import executor_of

    return executor_of(words)
