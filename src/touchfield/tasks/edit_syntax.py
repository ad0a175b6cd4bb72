"""Parses the texts by which a user of the command `edit` names a region and an operator."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import reduce
from typing import Final

from touchfield.errors import InvalidArgument
from touchfield.filters.edit import COMPOSITIONS, Compose, EditOperator, Erase, Gain, Limit, Move
from touchfield.filters.region import Ball, Box, Everywhere, ForceRange, HalfSpace, Region, RigidMotion
from touchfield.filters.registry import field_filters, filter_of, length_m
from touchfield.pipeline.preparation import Prepared
from touchfield.tasks.matching import match_medium, read_medium

REGIONS: Final[Mapping[str, tuple[str, Callable[..., Region]]]] = {
    "box": ("LLLLLL", lambda *v: Box(v[:3], v[3:])),
    "ball": ("LLLL", lambda *v: Ball(v[:3], v[3])),
    "half-space": ("NNNLLL", lambda *v: HalfSpace(v[:3], v[3:])),
}
"""For each region, the form of its numbers (see `_numbers`), and the function that makes it."""


def region_of(text: str) -> Region:
    """Parse a region; `|` is the union, `&` the intersection, `~` the complement.

    ``everywhere``; ``box:X,Y,Z,X,Y,Z``, low and high corner; ``ball:X,Y,Z,RADIUS``;
    ``half-space:NX,NY,NZ,X,Y,Z``, the side that the normal points to, and a point; ``force:LOW..HIGH``
    newtons. Lengths have a unit: 2mm, -0.5cm; bounds of a box may be inf. Raises InvalidArgument for any
    other text.
    """
    for sign in "|&":
        parts = text.split(sign)
        if len(parts) > 1:
            return reduce(lambda a, b: a | b if sign == "|" else a & b, map(region_of, parts))
    word = text.strip()
    if word.startswith("~"):
        return ~region_of(word[1:])
    name, _, values = word.partition(":")
    if name == "everywhere" and not values:
        return Everywhere()
    if name == "force":
        low, _, high = values.partition("..")
        return ForceRange(*_numbers("--region force", f"{low},{high or 'inf'}", "NN"))
    if name in REGIONS:
        form, make = REGIONS[name]
        return make(*_numbers(f"--region {name}", values, form))
    raise InvalidArgument(
        "--region", repr(text), "everywhere, box:, ball:, half-space: or force:, with | & ~"
    )


OPERATORS: Final[Mapping[str, tuple[tuple[str, ...], Callable[..., EditOperator]]]] = {
    "gain": (("N",), Gain),
    "limit": (("N",), Limit),
    "move": (("LLL",), lambda *v: Move(RigidMotion.move(v))),
    "turn": (("NNNN", "NNNNLLL"), lambda *v: Move(RigidMotion.turn(v[:3], v[3], v[4:] or (0.0, 0.0, 0.0)))),
    "mirror": (("NNN", "NNNLLL"), lambda *v: Move(RigidMotion.mirror(v[:3], v[3:] or (0.0, 0.0, 0.0)))),
}
"""For each operator, the forms of its numbers (see `_numbers`), and the function that makes it."""


def operator_of(text: str, like: Prepared) -> EditOperator:
    """Parse an operator.

    ``gain:2``; ``erase``; ``limit:1.5`` newtons; ``move:DX,DY,DZ``; ``turn:AX,AY,AZ,DEGREES`` and
    ``mirror:NX,NY,NZ``, each with a point ``,X,Y,Z`` that stays; ``over:FILE``, ``add:FILE``, ``max:FILE`` or
    ``replace:FILE``, another medium, frame by frame or of one frame; or a haptic filter,
    ``gaussian:sigma=2mm``. `like` is the medium to be edited; another medium is brought to its lattice.
    Raises InvalidArgument for any other text.
    """
    name, _, values = text.strip().partition(":")
    if name == "erase" and not values:
        return Erase()
    if name in OPERATORS:
        forms, make = OPERATORS[name]
        return make(*_numbers(f"--operator {name}", values, *forms))
    if name in COMPOSITIONS:
        other = read_medium(values)
        medium, _ = match_medium(other.medium, like.medium, name=values)
        return Compose(medium if len(medium) > 1 else medium[0], name)
    if name in field_filters():
        return filter_of(name, values)
    names = ", ".join(("gain", "erase", *list(OPERATORS)[1:], *COMPOSITIONS, *field_filters()))
    raise InvalidArgument("--operator", repr(text), f"one of {names}")


def _numbers(where: str, text: str, *forms: str) -> list[float]:
    """Parse numbers (N) and lengths (L, with a unit or infinite) between commas, by one of the forms."""
    parts = [part.strip() for part in text.split(",")]
    form = next((f for f in forms if len(f) == len(parts)), None)
    if form is None:
        expected = " or ".join(str(len(f)) for f in forms)
        raise InvalidArgument(where, repr(text), f"{expected} numbers between commas")
    numbers = []
    for part, kind in zip(parts, form, strict=True):
        if kind == "L" and part.lstrip("+-") not in ("inf", "0"):
            numbers.append(length_m(part, where))
            continue
        try:
            numbers.append(float(part))
        except ValueError:
            raise InvalidArgument(where, repr(part), "a number") from None
    return numbers
