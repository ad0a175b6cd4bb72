"""Tactile maps and diagrams: features of GeoJSON, OpenStreetMap and SVG, drawn with symbols that a finger can
tell apart, on the pins of a display, on swell paper and for printers.

A reader (`reader.read_map`) returns features with classes and names, `layout.draw` puts their symbols on the
pins by the cited guidelines of ``guidelines.toml``, and `check.check` measures the result on the pins.
"""

from typing import TYPE_CHECKING

from touchfield._lazy import lazy_attributes

if TYPE_CHECKING:
    from touchfield.maps.board import Layout
    from touchfield.maps.check import check
    from touchfield.maps.guidelines import guidelines
    from touchfield.maps.layout import draw
    from touchfield.maps.reader import read_map
    from touchfield.maps.symbols import symbols

__all__ = ["Layout", "check", "draw", "guidelines", "read_map", "symbols"]

_MODULES = {
    "board": ("Layout",),
    "check": ("check",),
    "guidelines": ("guidelines",),
    "layout": ("draw",),
    "reader": ("read_map",),
    "symbols": ("symbols",),
}
__getattr__ = lazy_attributes(__name__, _MODULES)
