"""Options that several commands share: how they read, place, filter and code a scene.

Each option is one row, and `with_options` adds rows to a command, so that commands stay consistent.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Annotated, Any, Final, NamedTuple

import typer

from touchfield.cli.main import BY_NAME
from touchfield.codec.registry import Coder, field_coders
from touchfield.errors import KINDS, InvalidArgument
from touchfield.filters.registry import field_filters
from touchfield.pipeline.rate_control import Target
from touchfield.pipeline.spec import COEFFICIENTS, EncodeSpec, Frames, require_frames, spec_field
from touchfield.sources.options import SourceOptions

DeviceCompute = Annotated[
    str,
    typer.Option(
        "--device-compute",
        help="Where forces of depth pictures are computed: cpu, cuda (extra cuda), or auto.",
    ),
]
"""Option of commands that compute fields of a scene."""

Workers = Annotated[
    str | None,
    typer.Option(
        "--workers",
        help="Who does the work: processes:N, joblib:N or ray:N of this machine, or a cluster: ray:ADDRESS, "
        "dask:ADDRESS.",
    ),
]


class Row(NamedTuple):
    """An option: its name, type, default and help, and its panel in the help (None: the common one)."""

    name: str
    kind: Any
    default: Any
    help_text: str
    panel: str | None = None

    @property
    def key(self) -> str:
        """Name of the field and the parameter."""
        return self.name.replace("-", "_")


def _kind(annotation: Any) -> Any:
    """Return the command-line type of a field by its annotation; types outside `KINDS` are given as text."""
    text = annotation.__name__ if isinstance(annotation, type) else str(annotation)
    name, none, _ = text.partition(" | None")
    kind, *_ = KINDS.get(name, KINDS["str"])
    return kind if name in KINDS and not none else kind | None


def rows_of(spec: Any, panel: str | None = None, *names: str) -> tuple[Row, ...]:
    """Return the fields of a spec that are options (`touchfield.options`): all, or those named."""
    selected = [field for field in fields(spec) if field.metadata and (not names or field.name in names)]
    return tuple(
        Row(dashed(field.name), _kind(field.type), field.default, field.metadata["help"], panel)
        for field in selected
    )


def rows(panel: str, *options: tuple[str, Any, Any, str]) -> tuple[Row, ...]:
    """Return options of one panel, each given by its name, type, default and help."""
    return tuple(Row(*option, panel) for option in options)


def dashed(name: str) -> str:
    """Return the option's name for a field's name."""
    return name.replace("_", "-")


_FIRST: Final = (
    "device", "nw", "frames", "mapping", "stiffness-n-per-m", "thickness-m", "k", "f0-n", "mode",
    "target-bytes",
)  # fmt: skip
"""Options of scene and coder that most people need."""
_LATTICE: Final = "Device and lattice"
_SCENE: Final = "Scene"

FORCE_ROWS: Final = rows_of(EncodeSpec, "Force", "vibration", *COEFFICIENTS)
ALLOW_EMPTY: Final = rows_of(EncodeSpec, _SCENE, "allow_empty")
SCENE: Final = (
    *rows(_LATTICE, ("nominal", bool, False, "Use the device's nominal lattice in place of 2^nw.")),
    *rows_of(EncodeSpec, _LATTICE, "representation", "fit_frames", "oversample", "pool", "cutoff"),
    *rows_of(EncodeSpec, "Force", "law", "thin", "band_m", "surface_damping_n_s_per_m"),
    *rows_of(EncodeSpec, _SCENE, "device", "nw", "frames", "mapping", "stiffness_n_per_m", "thickness_m"),
    *rows(_SCENE, ("as", str | None, None, "Kind of the source, where it is not recognised.")),
    *rows_of(SourceOptions, _SCENE),
)


def _options_of(coder: Coder) -> dict[str, tuple[Any, str]]:
    """Return the type and the help of each option of a coder."""
    option_types = {row.key: (row.kind, row.help_text) for row in rows_of(coder.spec)} | dict(
        coder.extra_options
    )
    return {key: option_types[key] for key in coder.options or option_types}


def _coder_rows() -> tuple[Row, ...]:
    """Return one option for each field of a coder; the help of a shared option names each coder."""
    coder_names = [word for coder in field_coders().values() for word in coder.makers]
    options: dict[str, tuple[Any, list[str], list[str]]] = {}
    for coder in field_coders().values():
        for key, (kind, help_text) in _options_of(coder).items():
            _, helps, names = options.setdefault(key, (kind, [], []))
            helps.append(f"{coder.name}: {help_text}")
            names.append(coder.name)
    coder_help = f"{', '.join(coder_names)} (literal: every part as printed in the paper)."
    coder_rows = [Row("coder", str, coder_names[0], coder_help, "Coder")]
    for key, (kind, helps, names) in options.items():
        value_type, default = (bool, False) if kind is bool else (kind | None, None)
        panel = "The paper's coder" if names == ["paper"] else "Coder"
        coder_rows.append(Row(dashed(key), value_type, default, " ".join(helps), panel))
    return tuple(coder_rows)


CODER: Final = _coder_rows()

TARGET: Final = rows(
    "Coder",
    (
        "target-nmse-db",
        float | None,
        None,
        "touch: the NMSE to reach, dB, such as -25; the mode is then nmse unless --mode is given.",
    ),
    (
        "target-bytes",
        int | None,
        None,
        "touch: the size to reach: k (mode nmse: the step) is raised until it fits.",
    ),
)


def address_rows(port: int, verb: str) -> tuple[Row, ...]:
    """Return the options of a server: its address and who may receive."""
    return rows(
        "Address",
        ("host", str, "127.0.0.1", "Address to listen at; beyond this machine only with a token."),
        ("port", int, port, "Port; 0: a free one."),
        ("token", str | None, None, "Word that a receiver must bring: ...?token=WORD."),
        ("open", bool, False, f"Let anyone {verb} who reaches the address."),
        (
            "cors",
            list[str] | None,
            None,
            "Origin of web pages that may read, such as https://example.org; or *.",
        ),
    )


def filter_rows() -> tuple[Row, ...]:
    """Return one option for each registered haptic filter; they are applied in command-line order."""
    kinds = field_filters().items()
    return rows("Haptic filters", *((name, list[str] | None, None, kind.summary) for name, kind in kinds))


def values_of(options: dict[str, Any], *groups: Sequence[Row]) -> dict[str, tuple[Any, Any]]:
    """Return the value and the default of the options of `groups`, by name."""
    return {row.name: (options[row.key], row.default) for group in groups for row in group}


def refuse_unused(values: Mapping[str, tuple[Any, Any]], reason: str) -> None:
    """Raise InvalidArgument for the first option whose value is not the default: it would have no effect.

    `values` has value and default by the name of the option; `reason` completes "--NAME has no effect".
    """
    if (name := first_given(values)) is not None:
        raise InvalidArgument(f"--{name} has no effect {reason}", hint="Take it out.")


def first_given(values: Mapping[str, tuple[Any, Any]]) -> str | None:
    """Return the name of the first option whose value is neither the default nor an empty list."""
    given = (name for name, (value, default) in values.items() if value != default and value != [])
    return next(given, None)


def with_options(*groups: Sequence[Row]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Add the options of `groups` to a command; it gets `options`, in the order of the command line."""
    all_rows = sorted((row for group in groups for row in group), key=lambda row: row.name not in _FIRST)

    def decorate(command: Any) -> Any:
        command.options = [_parameter(row) for row in all_rows]
        return command

    return decorate


def _parameter(row: Row) -> inspect.Parameter:
    help_text = row.help_text.replace("[", r"\[")  # brackets are not markup
    group = "What most people need" if row.panel and row.name in _FIRST else row.panel
    option = typer.Option(f"--{row.name}", help=help_text, rich_help_panel=group)
    key = "as_" if row.name == "as" else row.key
    return inspect.Parameter(key, BY_NAME, default=row.default, annotation=Annotated[row.kind, option])


def frames_of(option: str, text: str | None) -> Frames | None:
    """Parse START:STOP, or the number of one frame."""
    if text is None:
        return None
    start, colon, stop = text.partition(":")
    try:
        first = int(start or 0)
        last = int(stop) if stop else (None if colon else first + 1)
    except ValueError:
        raise InvalidArgument(option, repr(text), "START:STOP, such as 0:24") from None
    require_frames(option, (first, last))
    return first, last


def numbers_of(
    option: str, text: str | None, counts: Sequence[int], expected: str, kind: type = float
) -> Any:
    """Parse comma-separated numbers to a tuple, whose length must be one of `counts`."""
    try:
        numbers = tuple(kind(word) for word in (text or "").split(","))
    except ValueError:
        numbers = ()
    if len(numbers) not in counts:
        raise InvalidArgument(option, repr(text) if text else "nothing", expected)
    return numbers


def fields_of(spec: type[Any], options: dict[str, Any]) -> dict[str, Any]:
    """Return the option values of the fields of a spec."""
    return {f.name: options[f.name] for f in fields(spec) if f.name in options}


def _coder(options: dict[str, Any]) -> dict[str, Any]:
    """Return the coder and its options; an option of another coder raises InvalidArgument."""
    name, coders = options["coder"], field_coders().values()
    coder = next((candidate for candidate in coders if name in candidate.makers), None)
    if coder is None:
        raise InvalidArgument(
            "--coder", repr(name), f"one of {', '.join(w for candidate in coders for w in candidate.makers)}"
        )
    values = {key: value for key, value in options.items() if value is not None and value is not False}
    supported = {*_options_of(coder), *coder.hints}
    for other in coders:
        for key in _options_of(other):
            if key in values and key not in supported:
                fault = f"--{dashed(key)} works with --coder {other.name}, not with {name}"
                raise InvalidArgument(fault, hint="Take it out, or change the coder.")
    coder_options = {key: values[key] for key in values if key in supported}
    return {"coder": coder.name, spec_field(coder.name): coder.makers[name](coder_options)}


def encode_spec(options: dict[str, Any]) -> EncodeSpec:
    """Return the spec of an encoding from the options."""
    source = SourceOptions(kind=options["as"], **fields_of(SourceOptions, options))
    values = {name: value for name, value in fields_of(EncodeSpec, options).items() if name != "coder"}
    chain = []
    for name, texts in ((dashed(key), options[key]) for key in options):
        if name not in field_filters() or not texts:
            continue
        if len(texts) > 1:
            hint = "Filter twice: the .touch file of the first run may be the source of the second."
            raise InvalidArgument(f"--{name} can be given once, not {len(texts)} times", hint=hint)
        chain.append((name, field_filters()[name].expand(texts[0])))
    values |= {
        "nw": None if options["nominal"] else options["nw"],
        "frames": frames_of("--frames", options["frames"]),
        "fit_frames": frames_of("--fit-frames", options["fit_frames"]),
        "filters": tuple(chain),
    }
    return EncodeSpec(**values, source=source, **(_coder(options) if "coder" in options else {}))


def coder_spec(options: dict[str, Any]) -> EncodeSpec:
    """Return a spec from the coder's options alone, with defaults for the scene."""
    return encode_spec(options | {row.key: row.default for row in SCENE})


def target_of(options: dict[str, Any]) -> Target | None:
    """Return the requested size or error, or None."""
    if options["target_bytes"] is None and options["target_nmse_db"] is None:
        return None
    return Target(options["target_bytes"], options["target_nmse_db"])
