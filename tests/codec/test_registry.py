"""The coder registry: adding a third coder needs one folder and one line."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from types import ModuleType
from typing import Any

import pytest

from touchfield.cli.options import _options_of
from touchfield.codec import registry
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.segment import CodedSegment
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument, UnsupportedVersion
from touchfield.medium import ForceField, Grid
from touchfield.options import option

GRID = Grid((9, 8, 7), (1e-3,) * 3, (0, 0, 0))


@dataclass(frozen=True)
class CountSpec:
    """Options of a coder that stores only the number of frames."""

    k: float = 0.1
    segment_frames: int = 8
    letter: str = option("x", "a letter.")


class CountEncoder:
    name = "count"

    def __init__(self, grid: Grid, spec: CountSpec) -> None:
        self.parameters = spec.letter.encode()

    def encode_segment(self, frames: Sequence[ForceField]) -> CodedSegment:
        return CodedSegment(self.parameters * len(frames), ())


class CountDecoder:
    def __init__(self, grid: Grid, parameters: bytes, where: str = "") -> None:
        self.grid, self.parameters = grid, parameters

    def frames(self, body: bytes, frame_count: int) -> Iterator[ForceField]:
        assert body == self.parameters * frame_count
        return (ForceField.empty(self.grid) for _ in range(frame_count))


@pytest.fixture
def third_coder(monkeypatch: pytest.MonkeyPatch) -> None:
    module: Any = ModuleType("count_entry")
    module.CountEncoder, module.CountDecoder = CountEncoder, CountDecoder
    module.CODER = registry.Coder(
        "count", "count_entry:CountEncoder", "count_entry:CountDecoder", CountSpec,
        {"count": lambda options: CountSpec(**options)},
    )  # fmt: skip
    monkeypatch.setitem(sys.modules, "count_entry", module)
    monkeypatch.setitem(registry.ENTRIES, "count", "count_entry")
    return


@pytest.mark.usefixtures("third_coder")
def test_third_coder_needs_one_line() -> None:
    assert list(registry.field_coders()) == ["touch", "paper", "count"]
    encoder = registry.field_encoder(GRID, CountSpec(letter="z"))
    body = encoder.encode_segment([ForceField.empty(GRID)] * 3).body
    assert body == b"zzz"
    assert len(list(registry.field_decoder("count", GRID, encoder.parameters).frames(body, 3))) == 3


@pytest.mark.usefixtures("third_coder")
def test_command_line_uses_the_registry() -> None:
    from touchfield.cli import options

    rows = {row[0]: row for row in options._coder_rows()}
    assert rows["letter"][3] == "count: a letter." and rows["coder"][3].startswith(
        "touch, paper, paper-literal, count"
    )
    assert rows["k"][3].count("Weber fraction") == 2 and rows["lossless-quantised"][1:3] == (bool, False)
    requested = options._coder({"coder": "count", "letter": "q", "nq": None, "lossless_quantised": False})
    assert requested == {"coder": "count", "extension": CountSpec(letter="q")}
    with pytest.raises(InvalidArgument, match="--coder count"):
        options._coder({"coder": "paper", "letter": "q"})


def test_unknown_field_coders_are_refused() -> None:
    assert (
        registry.coder_of_spec(PaperSpec()).name == "paper"
        and registry.coder_of_spec(TouchSpec()).name == "touch"
    )
    with pytest.raises(InvalidArgument, match="spec of a coder"):
        registry.coder_of_spec(object())
    for name in ("count", "objects"):
        with pytest.raises(UnsupportedVersion, match="OBJT 2 field_coder"):
            registry.field_decoder(name, GRID, b"", "OBJT 2")


@pytest.mark.parametrize("name", ["touch", "paper"])
def test_every_option_is_a_spec_field_or_an_extra_option(name: str) -> None:
    entry = registry.coder(name)
    options = _options_of(entry)
    assert entry.spec is not None and {"k", "segment_frames"} <= options.keys()
    for key in options:
        assert hasattr(entry.spec(), key) or key in ("lossless_quantised", "body_site", "profile")
    spec_fields = {field.name for field in fields(entry.spec) if field.metadata}
    assert spec_fields | entry.extra_options.keys() == options.keys(), "an order that is given names all"
    assert all(isinstance(make({}), entry.spec) for make in entry.makers.values())
