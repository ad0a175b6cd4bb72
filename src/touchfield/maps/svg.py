"""Reads drawings in SVG with svgelements (extra ``map``): school diagrams, floor plans.

The class of an element follows from words in its id, its class and the labels of the layers around it; else
from its paint. An element with a fill is an area, one without a line: dashed if its stroke is dashed. Each
colour of areas without a class gets a texture of its own, of `FILLS` those that no class of the drawing has.
White areas are paper. Texts become
Braille labels. Nothing outside the file is read, and nothing is drawn that a browser does not draw.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import SourceError, import_extra
from touchfield.files import library_faults, read_bytes
from touchfield.maps.features import Collector, MapSource, clean_name, require_features
from touchfield.maps.symbols import FILLS, class_of_words, symbols
from touchfield.sources.mesh.instances import ROOT, Definitions

MAX_BYTES: Final = 1 << 22
MAX_ELEMENTS: Final = 1 << 16
"""Elements of the drawing, those of instances (``use``) counted each time."""
MAX_DEPTH: Final = 256
"""Of elements within elements."""
CURVE_POINTS: Final = 12
"""Points of a curve, its ends included: on a display of 60 pins a curve across it deviates by half a pin."""
WHITE: Final = 235
"""Least red, green and blue of paper."""
_EXPECTED: Final = "an SVG drawing"
_GIVEN_BY_PROGRAM: Final = re.compile(
    r"(path|rect|circle|ellipse|line|polyline|polygon|g|layer|svg|text|tspan|use|image|group|shape)[-_.]?\d[\d-]*"
)
"""Ids that drawing programs number by themselves."""
_SVG: Final = "{http://www.w3.org/2000/svg}"
_UNDRAWN: Final = ("mask", "marker", "symbol", "pattern", "clipPath", "flowRoot", "foreignObject")
"""Elements whose contents browsers draw by reference only, or not at all; svgelements draws them."""
_FLOWED: Final = "flowed texts (Inkscape: Text, Convert to Text)"
_HIDDEN: Final = "hidden layers or elements"
_LABELS: Final = (
    "{http://www.inkscape.org/namespaces/inkscape}label", "inkscape:label", "aria-label", "data-name", "id",
    "class",
)  # fmt: skip


def read_svg(path: Path) -> MapSource:
    """Read the elements of a drawing.

    Raises `MissingExtra` without svgelements; `SourceError` for what is no SVG, declares entities, uses an
    element within itself, or has more than the limits allow.
    """
    data = read_bytes(path, MAX_BYTES, _EXPECTED)
    outside = _check(path, data)
    svgelements = import_extra("svgelements", f"reading {path.name}", "svgelements", "map")
    found, root = Collector(str(path)), _parsed(path, data)
    if outside:
        found.left_out["references to other files, which are not read"] += outside
    with library_faults(path, "a drawing that svgelements does not read", _EXPECTED):
        drawing = svgelements.SVG.parse(BytesIO(_drawn(root, found)), reify=True)
        elements = list(_elements(svgelements, drawing, ()))
        colours = _Colours({class_of_words(labels, "area") for each, labels in elements if _has_fill(each)})
        for element, labels in reversed(elements):  # what lies on top takes the most important texture
            _add(svgelements, found, colours, element, labels)
    require_features(found, "lines, filled shapes or texts")
    title = clean_name(root.findtext(f"{_SVG}title") or "")
    return MapSource(tuple(found.features), None, None, found.notes(), title=title)


def _parsed(path: Path, data: bytes) -> ElementTree.Element:
    """Return the root; `SourceError` also for names that only XML without namespaces allows, as a:b:c."""
    try:
        return ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise SourceError(str(path), f"no XML ({error})", _EXPECTED) from error


def _drawn(root: ElementTree.Element, found: Collector) -> bytes:
    """Return the drawing with `_UNDRAWN` elements within ``defs``; count flowed texts and hidden parts."""
    for parent in list(root.iter()):
        for n, element in enumerate(parent):
            tag = str(element.tag).removeprefix(_SVG)
            style = element.get("style", "").replace(" ", "")
            if element.get("display") == "none" or "display:none" in style:
                found.left_out[_HIDDEN] += 1
            elif tag in _UNDRAWN:
                found.left_out[_FLOWED] += tag == "flowRoot"
                parent[n] = ElementTree.Element(f"{_SVG}defs")
                parent[n].append(element)
    found.left_out += Counter()  # without zeros
    return ElementTree.tostring(root)


def _is_hidden(element: Any) -> bool:
    values = getattr(element, "values", None) or {}
    opacity = str(values.get("opacity") or "1").rstrip("%")
    return values.get("visibility") in ("hidden", "collapse") or not opacity.strip("0.")


def _elements(svgelements: Any, group: Any, labels: tuple[str, ...]) -> Iterator[tuple[Any, tuple[str, ...]]]:
    """Yield the elements that are drawn, with their labels and those of the groups around them."""
    stack = [(group, labels)]
    while stack:
        element, outer = stack.pop()
        inner = (*_labels(element), *outer)[:16]
        if isinstance(element, svgelements.Group | svgelements.Use):
            stack += [(child, inner) for child in reversed(element)]
        else:
            yield element, inner


def _labels(element: Any) -> list[str]:
    values = getattr(element, "values", None) or {}
    own = values.get("attributes", values)
    texts = [str(own[key]) for key in _LABELS if own.get(key)]
    return [text[:200] for text in texts if not _GIVEN_BY_PROGRAM.fullmatch(text.lower())]


class _Colours:
    """The classes of areas by their colour, in the order in which they are asked for.

    `named` are the classes that the drawing names; none of the colours feels like one of them.
    """

    def __init__(self, named: set[str | None]) -> None:
        looks = {symbols()[kind].look for kind in named if kind is not None}
        self.textures = [kind for kind in FILLS if symbols()[kind].look not in looks]
        self._kinds: dict[tuple[int, int, int], str] = {}

    def kind_of(self, colour: tuple[int, int, int]) -> str | None:
        """Return the class of a colour; None if all textures are taken."""
        if colour not in self._kinds and len(self._kinds) < len(self.textures):
            self._kinds[colour] = self.textures[len(self._kinds)]
        return self._kinds.get(colour)


def _add(
    svgelements: Any, found: Collector, colours: _Colours, element: Any, labels: tuple[str, ...]
) -> None:
    if _is_hidden(element):
        found.left_out[_HIDDEN] += 1
        return
    if isinstance(element, svgelements.Text):
        text = (element.text or "").strip()
        if text:
            point = svgelements.Point(element.x or 0, element.y or 0) * element.transform
            found.add("text", "point", [[(point.x, -point.y)]], text)
        return
    if isinstance(element, svgelements.Image):
        found.left_out["pictures within the drawing"] += 1
        return
    if not isinstance(element, svgelements.Shape):
        return
    parts = [np.array(part) * (1, -1) for part in _subpaths(svgelements, element) if len(part) > 1]
    if not parts:
        return
    fill, stroke = _paint(element.fill), _paint(element.stroke)
    has_inside = any(len(part) > 2 for part in parts)
    if fill is not None and min(fill) < WHITE and has_inside:
        area_class = class_of_words(labels, "area") or colours.kind_of(fill)
        if area_class is None:
            found.left_out[
                f"areas of further colours than {len(colours.textures)}, for want of textures"
            ] += 1
        else:
            found.add(area_class, "area", [part for part in parts if len(part) > 2])
    elif class_of_words(labels, "point") and _is_closed(parts):
        kind = class_of_words(labels, "point") or ""
        low, high = np.concatenate(parts).min(axis=0), np.concatenate(parts).max(axis=0)
        found.add(kind, "point", [[(low + high) / 2]])
    elif stroke is not None and min(stroke) < WHITE:
        found.add(class_of_words(labels, "line") or _line_class(element), "line", parts)
    elif fill is not None or stroke is not None:
        found.left_out["white shapes, taken as paper"] += 1


def _line_class(element: Any) -> str:
    """Return the class of a line by its dashes: those shorter than twice the width are dots."""
    values = element.values or {}  # its `stroke_width` has the scale of the drawing, and dashes have not
    lengths = _numbers(values.get("stroke-dasharray"))[:2]
    if not lengths or max(lengths) <= 0:
        return "solid"
    width = (*_numbers(values.get("stroke-width")), 1.0)[0]
    return "dotted" if lengths[0] < 2 * width else "dashed"


def _numbers(text: Any) -> list[float]:
    return [float(number) for number in re.findall(r"\d+\.?\d*|\.\d+", str(text or ""))]


def _has_fill(element: Any) -> bool:
    """True for a shape with a fill other than paper."""
    fill = _paint(getattr(element, "fill", None))
    return fill is not None and min(fill) < WHITE


def _is_closed(parts: list[Float64s]) -> bool:
    return all(np.allclose(part[0], part[-1]) for part in parts)


def _paint(colour: Any) -> tuple[int, int, int] | None:
    """Return red, green and blue of a paint, or None."""
    if colour is None or colour.value is None or not colour.opacity:
        return None
    return int(colour.red), int(colour.green), int(colour.blue)


def _subpaths(svgelements: Any, shape: Any) -> Iterator[list[tuple[float, float]]]:
    """Yield the points of each subpath of a shape."""
    points: list[tuple[float, float]] = []
    start: tuple[float, float] | None = None
    for segment in abs(svgelements.Path(shape)):
        if isinstance(segment, svgelements.Move):
            yield points
            points = [_x_y(segment.end)]
            start = points[0]
        elif isinstance(segment, svgelements.Close):
            points += [start] if start is not None else []
        elif isinstance(segment, svgelements.Line):
            points.append(_x_y(segment.end))
        else:
            points += [_x_y(segment.point(t)) for t in np.linspace(0, 1, CURVE_POINTS)[1:]]
    yield points


def _x_y(point: Any) -> tuple[float, float]:
    return float(point.x), float(point.y)


# -- before svgelements reads it ---------------------------------------------------------------------------
def _check(path: Path, data: bytes) -> int:
    """Refuse what is no SVG, declares entities or expands too much; return the references to other files."""
    parser, definitions = expat.ParserCreate(), Definitions(str(path), MAX_ELEMENTS, "elements")
    enclosing, outside = [ROOT], 0
    count = 0

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal count, outside
        tag = name.rpartition(":")[2]
        if not count and tag != "svg":
            raise SourceError(str(path), f"the element {tag[:40]!r}", _EXPECTED)
        count += 1
        outer = enclosing[-1]
        inner = attributes.get("id") or f" {count}"
        definitions.sizes[inner] += 1
        definitions.uses[outer].append(inner)
        link = attributes.get("href") or attributes.get("xlink:href") or ""
        if tag == "use" and link.startswith("#"):
            definitions.uses[inner].append(link[1:])
        elif link and not link.startswith(("#", "data:")) and tag in ("use", "image", "script"):
            outside += 1
        enclosing.append(inner)
        if len(enclosing) > MAX_DEPTH:
            found = f"elements within elements, {len(enclosing)} deep"
            raise SourceError(str(path), found, f"up to {MAX_DEPTH}")

    def refuse(name: str, system: str | None, public: str | None, has_internal: bool) -> None:
        if has_internal:
            hint = "Save it as plain SVG, or remove the part in brackets after DOCTYPE."
            raise SourceError(str(path), "a document type with declarations", "plain SVG", hint)

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: enclosing.pop()
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, LookupError, ValueError) as error:  # the latter of unknown encodings
        raise SourceError(str(path), f"no XML ({error})", _EXPECTED) from error
    definitions.require_bounded(0)
    return outside
