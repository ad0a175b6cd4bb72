"""The options of the commands, once: how the scene is read, felt, mapped, filtered and coded.

Each is one row; `asks` gives a command the rows it takes, so that two commands cannot drift apart.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from touchfield.codec.paper_spec import PaperSpec
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument
from touchfield.filters.registry import field_filters
from touchfield.job import EncodeSpec, Target
from touchfield.sources.options import SourceOptions

__all__ = ["BESIDE", "CODER", "SCENE", "TARGET", "asks", "encode_spec", "filter_rows", "target_of"]

CODER_NAMES: Final = ("touch", "paper", "paper-literal")

Row = tuple[str, Any, Any, str]
"""Name, type, default, help."""

SCENE: tuple[Row, ...] = (
    ("device", str, "phantom-omni", "Device profile (see `touchfield devices`), or a TOML file of your own."),
    ("nw", int, 7, "2^nw samples per axis of the device's workspace, 3 to 10."),
    ("nominal", bool, False, "Use the device's nominal lattice in place of 2^nw."),
    ("representation", str, "auto", "voxel, object (fields and pose tracks), or auto."),
    ("frames", str | None, None, "Frames to take, START:STOP."),
    ("law", str, "penalty", "Force law: penalty, proximity, magnetic, or a sum such as penalty+proximity."),
    ("stiffness-n-per-m", float, 500.0, "Stiffness K, newtons per metre that the hand moves."),
    ("thickness-m", float | None, None, "Wall behind the surface, metres that the hand moves; inf is solid."),
    ("band-m", float, 0.004, "Reach of the proximity and magnetic laws, metres that the hand moves."),
    ("surface-damping-n-s-per-m", float, 0.0, "Drag of a moving surface: b times its velocity is added."),
    ("mapping", str, "fit", "Scene to workspace: fit, crop, or a factor such as 0.05."),
    ("oversample", int, 2, "Samples per axis and device sample before the anti-alias low-pass."),
    ("pool", str, "max", "Depth pooling of an actuator array: max or mean."),
    ("cutoff", str, "nyquist", "Low-pass of an actuator array: nyquist = 1/(2d), or literal = 2/d."),
    ("as", str | None, None, "Kind of the source, where it is not recognised."),
    ("depth-scale", float | None, None, "Stored depth units in a metre."),
    ("intrinsics", str | None, None, "Camera: fx,fy,cx,cy in pixels, or a file."),
    ("frame", str, "world", "Depth sequences: world (poses are used) or camera."),
    ("reading", str, "camera", "Depth maps: camera (metric, a wall) or height (solid, as in the paper)."),
    ("shell", str, "auto", "Open meshes: one or two sided."),
    ("cell-size-m", float | None, None, "Height maps: metres between samples."),
    ("height-scale", float | None, None, "Height maps: metres of one stored unit."),
    ("exaggeration", float, 1.0, "Height maps: factor on heights."),
    ("unit-m", float | None, None, "Meshes: metres of one unit."),
    ("rate-hz", float | None, None, "Frames a second of the medium; depth frames are interpolated in time."),
    ("seconds", float | None, None, "Simulations: their duration."),
    ("source-rate-hz", float | None, None, "Frames a second of the source, where it does not say."),
    ("interpolation", str, "linear", "Between depth frames: linear, edges (not across depth edges) or nearest."),
    ("animation", str | None, None, "Animated models: name or number of the animation."),
    ("relative-depth", str | None, None, "Pictures and videos: the relative depth beside them."),
    ("near-m", float | None, None, "Relative depth: metres of its nearest value."),
    ("far-m", float | None, None, "Relative depth: metres of its farthest value."),
    ("segment", str | None, None, "Depth sequences as objects: the rule of segmentation."),
    ("baseline-m", float | None, None, "Disparity maps: distance between the cameras."),
    ("disparity-offset-px", float | None, None, "Disparity maps: offset of the principal points."),
)

CODER: tuple[Row, ...] = (
    ("coder", str, "touch", "touch, paper, or paper-literal (every part of the paper's coder as printed)."),
    ("k", float | None, None, "Weber fraction: of the promise (touch) or of the deadband (paper). [default: 0.1]"),
    (
        "segment-frames",
        int | None,
        None,
        "Frames in a segment. [default: a quarter of a second, 8 to 64; paper: 8]",
    ),
    ("f0-n", float | None, None, "touch: F_0 of the promise, newtons. [default: 0.05]"),
    ("mode", str | None, None, "touch: mask (|error| <= max(F_0, k |F|); default), mask-direction, or nmse."),
    ("direction-jnd-deg", float | None, None, "touch, mask-direction: greatest angle, degrees. [default: 18.4]"),
    ("step-n", float | None, None, "touch, nmse: step of the lattice, newtons. [default: 0.05]"),
    ("support", str | None, None, "touch: movable (where |F| is at most F_0), or exact. [default: movable]"),
    ("effort", str | None, None, "touch: fast, default or max: bytes against time. [default: default]"),
    ("lossless-quantised", bool, False, "touch: keep a field that is quantised already exactly."),
    ("interframe", str | None, None, "touch: auto, off or on; paper: closed, open or none. [default: auto, closed]"),
    ("nq", int | None, None, "paper: bits of amplitude. [default: 6]"),
    ("directions", str | None, None, "paper: codebook: ico5 (252), octa3 (258), ico3 (92), ico1 to ico20."),
    ("amplitude", str | None, None, "paper: amplitude quantiser: lloyd-max (default), weber or uniform."),
    ("deadband", str | None, None, "paper: closed, last-sent, previous, zero or none. [default: closed]"),
)

BESIDE: tuple[Row, ...] = (
    (
        "vibration",
        str | None,
        None,
        "Vibration beside the force: gain=0.1,frequency=150, or rising: frequency=80..250.",
    ),
    ("friction", float | None, None, "Friction coefficient mu, which the receiver renders; default: the source's."),
    (
        "damping-n-s-per-m",
        float | None,
        None,
        "Damping coefficient b, which the receiver renders; default: as above.",
    ),
)

TARGET: tuple[Row, ...] = (
    ("target-nmse-db", float | None, None, "touch: the NMSE to reach, dB, such as -25; mode nmse unless asked."),
    ("target-bytes", int | None, None, "touch: the size to reach: k (mode nmse: the step) is raised until it fits."),
)


def filter_rows() -> tuple[Row, ...]:
    """One option for each registered haptic filter; their order on the command line is their order of work."""
    return tuple((name, list[str] | None, None, kind.summary) for name, kind in field_filters().items())


def asks(*groups: tuple[Row, ...]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Give a command the options of `groups`; it gets them as one dictionary, `asked`."""

    def give(command: Callable[..., Any]) -> Callable[..., Any]:
        own = [p for p in inspect.signature(command, eval_str=True).parameters.values() if p.name != "asked"]
        rows = [row for group in groups for row in group]
        more = [
            inspect.Parameter(
                _identifier(name),
                inspect.Parameter.KEYWORD_ONLY,
                default=default,
                annotation=Annotated[kind, typer.Option(f"--{name}", help=text)],
            )
            for name, kind, default, text in rows
        ]

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


def _identifier(name: str) -> str:
    return "as_" if name == "as" else name.replace("-", "_")


def _frames(text: str | None) -> tuple[int, int | None] | None:
    if text is None:
        return None
    start, colon, stop = text.partition(":")
    try:
        first = int(start or 0)
        last = int(stop) if stop else (None if colon else first + 1)
    except ValueError:
        raise InvalidArgument("--frames", repr(text), "START:STOP, such as 0:24") from None
    if first < 0 or (last is not None and last <= first):
        raise InvalidArgument("--frames", repr(text), "START below STOP, neither negative")
    return first, last


def _of(spec: type[Any], asked: dict[str, Any]) -> dict[str, Any]:
    """What was asked of the fields of a spec; an option is called as its field is."""
    return {f.name: asked[f.name] for f in fields(spec) if f.name in asked}


def _coder(asked: dict[str, Any]) -> dict[str, Any]:
    """The coder and what is asked of it; an option of another coder is refused, not ignored."""
    name = asked["coder"]
    if name not in CODER_NAMES:
        raise InvalidArgument("--coder", repr(name), f"one of {', '.join(CODER_NAMES)}")
    given = {key: value for key, value in asked.items() if value is not None and value is not False}
    own, other = (TouchSpec, PaperSpec) if name == "touch" else (PaperSpec, TouchSpec)
    if name != "touch" and "lossless_quantised" in given:
        raise _of_another("lossless_quantised", "touch", name)
    for key in _of(other, given):
        if key not in {f.name for f in fields(own)}:
            raise _of_another(key, "paper" if name == "touch" else "touch", name)
    chosen = _of(own, given)
    if name == "touch":
        return {"coder": "touch", "touch": TouchSpec(**_mode(chosen, given))}
    paper = PaperSpec(**chosen) if name == "paper" else PaperSpec.literal(**chosen)
    return {"coder": "paper", "paper": paper}


def _mode(chosen: dict[str, Any], given: dict[str, Any]) -> dict[str, Any]:
    """What is asked of coder `touch`, with the mode that other options imply, and none that does nothing in it."""
    if "lossless_quantised" in given:
        for key in ("mode", "k", "f0_n", "support"):
            if key in chosen:
                found = f"it together with {_option('lossless_quantised')}, which keeps every force as it is"
                raise InvalidArgument(_option(key), found, "one of both")
        chosen = {**chosen, "mode": "lossless"}
    if "target_nmse_db" in given:
        chosen = {"mode": "nmse", **chosen}
    mode = chosen.get("mode", TouchSpec.mode)
    for key, only in (("direction_jnd_deg", "mask-direction"), ("step_n", "nmse")):
        if key in chosen and mode != only:
            expected = f"it in mode {only} only"
            raise InvalidArgument(_option(key), f"it in mode {mode}", expected, f"Add --mode {only}.")
    return chosen


def _of_another(key: str, coder: str, taken: str) -> InvalidArgument:
    mend = f"Take it out, or add --coder {coder}."
    return InvalidArgument(_option(key), f"it with --coder {taken}", f"it with --coder {coder} only", mend)


def _option(key: str) -> str:
    return "--" + key.replace("_", "-")


def _filter_name(key: str) -> str | None:
    name = key.replace("_", "-")
    return name if name in field_filters() else None


def _once(name: str, words: list[str]) -> str:
    if len(words) > 1:
        mend = "Filter twice: the .touch file of the first run may be the source of the second."
        raise InvalidArgument(f"--{name}", f"it {len(words)} times", "once", mend)
    return words[0]


def encode_spec(asked: dict[str, Any]) -> EncodeSpec:
    """What was asked on the command line, as the job takes it."""
    source = SourceOptions(kind=asked["as"], **_of(SourceOptions, asked))
    if source.intrinsics and Path(source.intrinsics).suffix and not Path(source.intrinsics).exists():
        looks_like_numbers = all(c in "0123456789.,+-eE " for c in source.intrinsics)
        if not looks_like_numbers:
            raise InvalidArgument("--intrinsics", repr(source.intrinsics), "fx,fy,cx,cy or a file that exists")
    as_given = {name: value for name, value in _of(EncodeSpec, asked).items() if name != "coder"}
    chain = tuple((name, _once(name, asked[key])) for key in asked if (name := _filter_name(key)) and asked[key])
    as_given |= {
        "nw": None if asked["nominal"] else asked["nw"],
        "frames": _frames(asked["frames"]),
        "filters": chain,
    }
    return EncodeSpec(**as_given, source=source, **(_coder(asked) if "coder" in asked else {}))


def target_of(asked: dict[str, Any]) -> Target | None:
    """The size or the error to reach, where one was asked for."""
    if asked["target_bytes"] is None and asked["target_nmse_db"] is None:
        return None
    return Target(asked["target_bytes"], asked["target_nmse_db"])
