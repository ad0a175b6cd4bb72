"""Regions and operators of an edit in words, as a command line takes them (paper section 4, "haptic editing")."""

from __future__ import annotations

from functools import reduce

from touchfield.errors import InvalidArgument
from touchfield.filters.edit import COMPOSITIONS, Composed, EditOperator, Erased, Gain, Limited, Moved
from touchfield.filters.region import Ball, Box, Everywhere, ForceRange, HalfSpace, Region
from touchfield.filters.registry import field_filters, filter_of, length_m
from touchfield.filters.resample import RigidMotion
from touchfield.job.joining import joined, read_medium
from touchfield.job.prepare import Prepared

__all__ = ["operator_of", "region_of"]


def region_of(text: str) -> Region:
    """A region in words; `|` is the union, `&` what both share, `~` all that is not in it.

    ``everywhere``; ``box:X,Y,Z,X,Y,Z``, low and high corner; ``ball:X,Y,Z,RADIUS``; ``half-space:NX,NY,NZ,X,Y,Z``,
    the side that the normal points to, and a point; ``force:LOW..HIGH`` newtons. Lengths have a unit: 2mm, -0.5cm;
    bounds of a box may be inf.

    Raises
    ------
    InvalidArgument
        If the words make no sense.
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
    if name == "box":
        low, high = _triples("--region box", values, "LLLLLL")
        return Box(low, high)
    if name == "ball":
        x, y, z, radius = _numbers("--region ball", values, "LLLL")
        return Ball((x, y, z), radius)
    if name == "half-space":
        normal, through = _triples("--region half-space", values, "NNNLLL")
        return HalfSpace(normal, through)
    if name == "force":
        least, _, most = values.partition("..")
        bounds = _numbers("--region force", f"{least},{most or 'inf'}", "NN")
        return ForceRange(bounds[0], bounds[1])
    raise InvalidArgument("--region", repr(text), "everywhere, box:, ball:, half-space: or force:, with | & ~")


def operator_of(text: str, like: Prepared) -> EditOperator:
    """What is done within a region, in words.

    ``gain:2``; ``erase``; ``limit:1.5`` newtons; ``move:DX,DY,DZ``; ``turn:AX,AY,AZ,DEGREES`` and
    ``mirror:NX,NY,NZ``, each with a point ``,X,Y,Z`` that stays; ``over:FILE``, ``add:FILE``, ``max:FILE`` or
    ``replace:FILE``, another medium, frame by frame or a still one; or a haptic filter, ``gaussian:sigma=2mm``.

    Parameters
    ----------
    text : str
    like : Prepared
        The medium to be edited: another one is brought onto its lattice.

    Raises
    ------
    InvalidArgument
        If the words make no sense.
    """
    name, _, values = text.strip().partition(":")
    where = f"--operator {name}"
    if name == "gain":
        return Gain(_numbers(where, values, "N")[0])
    if name == "erase" and not values:
        return Erased()
    if name == "limit":
        return Limited(_numbers(where, values, "N")[0])
    if name == "move":
        return Moved(RigidMotion.move(_numbers(where, values, "LLL")))
    if name == "turn":
        x, y, z, degrees, *about = _numbers(where, values, "NNNN", "NNNNLLL")
        return Moved(RigidMotion.turn((x, y, z), degrees, about or (0.0, 0.0, 0.0)))
    if name == "mirror":
        x, y, z, *through = _numbers(where, values, "NNN", "NNNLLL")
        return Moved(RigidMotion.mirror((x, y, z), through or (0.0, 0.0, 0.0)))
    if name in COMPOSITIONS:
        other = read_medium(values)
        medium, _ = joined(other.medium, like.medium, name=values)
        return Composed(medium if len(medium) > 1 else medium[0], name)
    if name in field_filters():
        return filter_of(name, values)
    names = ", ".join(("gain", "erase", "limit", "move", "turn", "mirror", *COMPOSITIONS, *field_filters()))
    raise InvalidArgument("--operator", repr(text), f"one of {names}")


def _numbers(where: str, text: str, *forms: str) -> list[float]:
    """Numbers (N) and lengths (L, with a unit or infinite) between commas, as one of the forms has them."""
    parts = [part.strip() for part in text.split(",")]
    form = next((f for f in forms if len(f) == len(parts)), None)
    if form is None:
        expected = " or ".join(str(len(f)) for f in forms)
        raise InvalidArgument(where, repr(text), f"{expected} numbers between commas")
    return [_number(where, part, kind) for part, kind in zip(parts, form, strict=True)]


def _number(where: str, part: str, kind: str) -> float:
    if kind == "L" and part.lstrip("+-") not in ("inf", "0"):
        return length_m(part, where)
    try:
        return float(part)
    except ValueError:
        raise InvalidArgument(where, repr(part), "a number") from None


def _triples(where: str, text: str, form: str) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    a, b, c, d, e, f = _numbers(where, text, form)
    return (a, b, c), (d, e, f)
