"""The coders: one entry each, by the name that a file gives.

An entry is a `Coder`: of this package ``CODER`` of a module in `ENTRIES`, of other distributions an entry
point of the group ``touchfield.coders``, whose name is the coder's. Entries are light: classes that code are
named, and imported when they are first used.
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
"""The first is the default."""


class FieldEncoder(Protocol):
    """Encoder of segments whose frames are fields on one lattice; safe to use from several threads."""

    @property
    def name(self) -> str:
        """The coder's name in a file."""

    @property
    def parameters(self) -> bytes:
        """Knowledge of the decoder beside the bodies."""

    def encode_segment(self, frames: Sequence[ForceField]) -> CodedSegment:
        """Code one independent group of frames."""


@runtime_checkable
class AnchoringEncoder(FieldEncoder, Protocol):
    """One whose segments of a world that stands begin with the same forces."""

    def anchor(self, frame: ForceField, before: ForceField | None) -> ForceField:
        """The field to begin a segment with whose first frame this is: the anchor before, if that is as good."""

    def encode_segment(self, frames: Sequence[ForceField], anchor: ForceField | None = None) -> CodedSegment:
        """Code one independent group of frames, with an anchor in place of the first."""


@runtime_checkable
class AmendingEncoder(FieldEncoder, Protocol):
    """One that can send single samples exactly, in a segment that is coded already."""

    def with_exact_samples(
        self, segment: CodedSegment, frames: Sequence[ForceField], samples: Sequence[Int64s]
    ) -> CodedSegment:
        """The segment with these samples exact; numbers 512 key of the brick + sample, int64 [m] of each
        frame.
        """


class FieldDecoder(Protocol):
    """Decoder of segments whose frames are fields on one lattice."""

    def frames(self, body: bytes, frame_count: int) -> Iterator[ForceField]:
        """The frames of a segment, one after another."""

    def costs(self, body: bytes, frame_count: int) -> Sequence[FrameCost]:
        """Cost of each frame of a segment, without decoding it."""

    def describe(self) -> dict[str, Any]:
        """Stable keys for people and programs."""


@dataclass(frozen=True)
class Coder:
    """A coder, as the rest of the package knows it."""

    name: str  # in files
    # classes as ``module:Class``; of a coder of fields ``encoder(grid, spec)`` is a `FieldEncoder` and
    # ``decoder(grid, parameters, where)`` a `FieldDecoder`
    encoder: str
    decoder: str
    # what may be asked of it, a frozen dataclass with `k` and `segment_frames`; None for what codes no fields
    spec: type[Any] | None = None
    # the words of ``--coder`` that mean this coder, each with what makes a spec of the options that were
    # given
    makers: Mapping[str, Callable[[dict[str, Any]], Any]] = field(default_factory=dict)
    # words of the makers that are no field of the spec, each with its type and its help
    # (`touchfield.options`)
    words: Mapping[str, tuple[type, str]] = field(default_factory=dict)
    options: tuple[str, ...] = ()  # the order of both on the command line, if it is another
    hints: tuple[str, ...] = ()  # keys of options of other rooms that its makers want to see
    # ``resolve(spec, is_array)``: the spec with what is "auto" resolved for a kind of device
    resolve: Callable[[Any, bool], Any] = lambda spec, is_array: spec
    # ``summary(spec)``: what the summary of an encoded file tells of it
    summary: Callable[[Any], dict[str, Any]] = lambda spec: {}
    # ``bound(spec)``: the `BoundRule` of a spec; by default of a coder that guarantees nothing
    bound: Callable[[Any], BoundRule] | None = None
    has_promise: bool = False  # the decoder's ``worst(body)`` is the worst voxel of a segment
    has_codewords: bool = False  # decoded forces are codewords: measures may take each vector as a symbol

    def bound_rule(self, spec: object) -> BoundRule:
        """What is guaranteed of each voxel under a spec."""
        if self.bound is None:
            other = next(iter(ENTRIES))
            return BoundRule(None, f"coder {self.name} bounds the error of no voxel; take --coder {other}")
        return self.bound(spec)

    @property
    def encoder_class(self) -> Any:
        """The class that encodes."""
        return resolve_name(self.encoder)

    @property
    def decoder_class(self) -> Any:
        """The class that decodes."""
        return resolve_name(self.decoder)


def field_coders() -> dict[str, Coder]:
    """The coders of fields by name; the first is the default."""
    entries = {name: coder(name) for name in names()}
    return {name: entry for name, entry in entries.items() if entry.spec is not None}


def names() -> tuple[str, ...]:
    """The names of all coders, the default first, those of plug-ins last."""
    return (*ENTRIES, *(name for name in plugins("touchfield.coders", Coder) if name not in ENTRIES))


def coder(name: str, where: str = "HEAD.coder") -> Coder:
    """The entry of a coder; UnsupportedVersion if there is none, `where` being the field that names it."""
    if name not in names():
        known = " or ".join(map(repr, names()))
        raise UnsupportedVersion(
            where, repr(name), known, "A newer touchfield reads it, or a plug-in for this coder."
        )
    entry: Coder = (
        resolve_name(f"{ENTRIES[name]}:CODER")
        if name in ENTRIES
        else plugins("touchfield.coders", Coder)[name]
    )
    return entry


def coder_of_spec(spec: object) -> Coder:
    """The coder of fields that a spec asks; InvalidArgument if it is the spec of none."""
    for one in field_coders().values():
        if one.spec is not None and isinstance(spec, one.spec):
            return one
    raise InvalidArgument("coder", type(spec).__name__, "the spec of a coder of fields")


def field_encoder(grid: Grid, spec: object) -> FieldEncoder:
    """Encoder of fields on a lattice, as a spec asks."""
    made: FieldEncoder = coder_of_spec(spec).encoder_class(grid, spec)
    return made


def field_decoder(name: str, grid: Grid, parameters: bytes, where: str = "OBJT") -> FieldDecoder:
    """A decoder of the fields of an object, on its own lattice; `where` is its record.

    UnsupportedVersion if there is no such coder of fields, CorruptFile if the parameters are not those of the
    coder.
    """
    found = coder(name, f"{where} field_coder")
    if found.spec is None:
        raise UnsupportedVersion(f"{where} field_coder", repr(name), " or ".join(map(repr, field_coders())))
    made: FieldDecoder = found.decoder_class(grid, parameters, f"{where} field_parameters")
    return made
