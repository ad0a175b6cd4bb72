"""Finds a coder by the name that a ``.touch`` file stores (`touch`, `paper`, `objects`, or one of a plug-in),
and defines the interfaces that every encoder and decoder must provide.

An entry is a `Coder`. Those of this package are the ``CODER`` of each module in `ENTRIES`; other
distributions register an entry point in the group ``touchfield.coders`` under the coder's name. An entry
names its encoder and decoder classes, which are imported on first use.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Final, Protocol, runtime_checkable

from touchfield.codec.segment import BoundRule
from touchfield.errors import InvalidArgument, UnsupportedVersion
from touchfield.plugins import plugins

if TYPE_CHECKING:
    from touchfield.arrays import Int64s
    from touchfield.codec.segment import CodedSegment, FrameCost
    from touchfield.medium import ForceField, Grid


ENTRIES: Final = {
    "touch": "touchfield.codec.touch.spec",
    "paper": "touchfield.codec.paper.spec",
    "objects": "touchfield.codec.objects.layout",
}
"""Modules of the coders of this package by name; the first is the default."""


class FieldEncoder(Protocol):
    """Encoder of segments whose frames are fields on one lattice; thread-safe."""

    @property
    def name(self) -> str:
        """The coder's name in a file."""

    @property
    def parameters(self) -> bytes:
        """The bytes that the decoder needs in addition to the segment bodies."""

    def encode_segment(self, frames: Sequence[ForceField]) -> CodedSegment:
        """Code one independent group of frames."""


@runtime_checkable
class KeyFrameEncoder(FieldEncoder, Protocol):
    """Encoder whose segments of a static scene share one key frame."""

    def key_frame(self, frame: ForceField, previous: ForceField | None) -> ForceField:
        """The field to start a segment with.

        `previous` if it is close enough to `frame`, else `frame`.
        """

    def encode_segment(
        self, frames: Sequence[ForceField], key_frame: ForceField | None = None
    ) -> CodedSegment:
        """Code one independent group of frames, with a key frame in place of the first."""


@runtime_checkable
class ExactSampleEncoder(FieldEncoder, Protocol):
    """Encoder that can make single samples of a coded segment exact."""

    def with_exact_samples(
        self, segment: CodedSegment, frames: Sequence[ForceField], samples: Sequence[Int64s]
    ) -> CodedSegment:
        """The segment, with the given samples made exact.

        `samples`: int64 [m] for each frame; a sample is numbered 512 times the key of its brick plus its
        index within the brick.
        """


class FieldDecoder(Protocol):
    """Decoder of segments whose frames are fields on one lattice."""

    def frames(self, body: bytes, frame_count: int) -> Iterator[ForceField]:
        """Yield the frames of a segment in order."""

    def costs(self, body: bytes, frame_count: int) -> Sequence[FrameCost]:
        """Cost of each frame of a segment, without decoding it."""

    def describe(self) -> dict[str, Any]:
        """Parameters of the stream, under stable keys."""


@dataclass(frozen=True)
class Coder:
    """Entry of a coder in the registry."""

    name: str  # in files
    # classes as ``module:Class``; for a coder of fields ``encoder(grid, spec)`` returns a `FieldEncoder` and
    # ``decoder(grid, parameters, where)`` a `FieldDecoder`
    encoder: str
    decoder: str
    # class of its options, a frozen dataclass with `k` and `segment_frames`; None if it codes no fields
    spec: type[Any] | None = None
    # values of ``--coder`` that select this coder, each with a function from given options to a spec
    makers: Mapping[str, Callable[[dict[str, Any]], Any]] = field(default_factory=dict)
    # options of the makers that are not fields of the spec, each with its type and its help
    # (`touchfield.options`)
    extra_options: Mapping[str, tuple[type, str]] = field(default_factory=dict)
    options: tuple[str, ...] = ()  # order of all options on the command line, if not the default one
    hints: tuple[str, ...] = ()  # options of other packages that its makers need to see
    # ``resolve(spec, is_array)``: the spec with every "auto" resolved for a kind of device
    resolve: Callable[[Any, bool], Any] = lambda spec, is_array: spec
    # ``summary(spec)``: its entries in the summary of an encoded file
    summary: Callable[[Any], dict[str, Any]] = lambda spec: {}
    # ``bound(spec)``: the `BoundRule` of a spec; None for a coder that guarantees nothing
    bound: Callable[[Any], BoundRule] | None = None
    has_error_bound: bool = False  # the decoder has ``max_error(body)``, the `MaxError` of a segment
    has_codewords: bool = False  # decoded forces are codewords: measures may take each vector as a symbol

    def bound_rule(self, spec: object) -> BoundRule:
        """The error bound of each voxel under a spec."""
        if self.bound is None:
            other = next(iter(ENTRIES))
            return BoundRule(None, f"coder {self.name} bounds the error of no voxel; take --coder {other}")
        return self.bound(spec)

    @property
    def encoder_class(self) -> Any:
        """The encoder class."""
        return resolve_name(self.encoder)

    @property
    def decoder_class(self) -> Any:
        """The decoder class."""
        return resolve_name(self.decoder)


def field_coders() -> dict[str, Coder]:
    """The coders of fields by name; the first is the default."""
    entries = {name: coder(name) for name in names()}
    return {name: entry for name, entry in entries.items() if entry.spec is not None}


def names() -> tuple[str, ...]:
    """The names of all coders, the default first, those of plug-ins last."""
    return (*ENTRIES, *(name for name in plugins("touchfield.coders", Coder) if name not in ENTRIES))


def coder(name: str, where: str = "HEAD.coder") -> Coder:
    """Entry of a coder; UnsupportedVersion if there is none of this name.

    `where` names the field in the error.
    """
    if name not in names():
        expected = " or ".join(map(repr, names()))
        raise UnsupportedVersion(
            where, repr(name), expected, "A newer touchfield reads it, or a plug-in for this coder."
        )
    entry: Coder = (
        resolve_name(f"{ENTRIES[name]}:CODER")
        if name in ENTRIES
        else plugins("touchfield.coders", Coder)[name]
    )
    return entry


def coder_of_spec(spec: object) -> Coder:
    """The coder of fields that a spec belongs to; InvalidArgument if there is none."""
    for entry in field_coders().values():
        if entry.spec is not None and isinstance(spec, entry.spec):
            return entry
    raise InvalidArgument("coder", type(spec).__name__, "the spec of a coder of fields")


def field_encoder(grid: Grid, spec: object) -> FieldEncoder:
    """Encoder of fields on a lattice, for a spec."""
    encoder: FieldEncoder = coder_of_spec(spec).encoder_class(grid, spec)
    return encoder


def field_decoder(name: str, grid: Grid, parameters: bytes, where: str = "OBJT") -> FieldDecoder:
    """Decoder of the fields of an object on its own lattice.

    `where` names the object's record in errors. UnsupportedVersion if no coder of fields has this name,
    CorruptFile if the parameters are not valid for the coder.
    """
    entry = coder(name, f"{where} field_coder")
    if entry.spec is None:
        raise UnsupportedVersion(f"{where} field_coder", repr(name), " or ".join(map(repr, field_coders())))
    decoder: FieldDecoder = entry.decoder_class(grid, parameters, f"{where} field_parameters")
    return decoder
