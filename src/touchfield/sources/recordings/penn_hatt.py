"""Reads the texture models of the Penn Haptic Texture Toolkit: a filter for each speed and force of a tool.

A file ``Models_MATERIAL.xml`` has the root element ``modelSet``. Source of the layout: the 100 model files at
1 kHz (`touchfield data show penn-hatt`). The acceleration of a tool that slides at a speed and presses with a
force is white noise of the variance ``var``, filtered by gain * MA(z) / AR(z); models at 10 kHz have neither
MAcoeff nor gain. Speeds are in mm/s, forces in newtons, accelerations in m/s^2; other units are refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s
from touchfield.errors import SourceError
from touchfield.files import read_bytes

_EXPECTED: Final = "texture models of the Penn Haptic Texture Toolkit (Models_MATERIAL.xml)"
_MAX_BYTES: Final = 1 << 24
_MAX_MODELS: Final = 1 << 10
_MAX_ORDER: Final = 1 << 8
_UNITS: Final = {"AccelUnits": "m/s^2", "SpeedUnits": "mm/s", "ForceUnits": "N"}
_HEAD_BYTES: Final = 1 << 10


@dataclass(frozen=True)
class TextureModel:
    """Vibration of a tool at one speed and force: filtered white noise."""

    speed_m_s: float
    force_n: float
    variance: float  # of the noise
    gain: float
    ar: Float64s  # float64 [order + 1], the first is 1
    ma: Float64s  # float64 [order + 1]; [1.0] if there is none

    def response(self, frequencies_hz: Float64s, rate_hz: float) -> NDArray[np.complex128]:
        """Return the filter's response, complex128 [n], at frequencies up to half the rate."""
        z = np.exp(-2j * np.pi * frequencies_hz / rate_hz)
        return np.asarray(self.gain * np.polyval(self.ma[::-1], z) / np.polyval(self.ar[::-1], z))


@dataclass(frozen=True)
class TextureModels:
    """Models of one surface."""

    name: str
    friction: float
    rate_hz: float
    models: tuple[TextureModel, ...]


def is_texture_models(path: Path) -> bool:
    """Return True if the first bytes of an ``.xml`` file name the root element ``modelSet``."""
    if path.suffix.lower() != ".xml" or not path.is_file():
        return False
    with path.open("rb") as file:
        return b"<modelSet" in file.read(_HEAD_BYTES)


def read_texture_models(path: Path) -> TextureModels:
    """Read the models of a surface.

    Raises `SourceError`, which names the model and the element, if the file cannot be read, has a document
    type or another unit, a number is missing or out of range, or a filter is unstable.
    """
    root = _parse(path)
    for name, unit in _UNITS.items():
        found = _text(root, name, str(path))
        if found != unit:
            raise SourceError(f"{path}: {name}", repr(found[:40]), unit)
    elements = root.findall("model")
    if not 1 <= len(elements) <= _MAX_MODELS:
        raise SourceError(str(path), f"{len(elements)} elements model", f"1 to {_MAX_MODELS}")
    stated = root.findtext("numMod")
    if stated is not None and stated.strip() != str(len(elements)):
        found = f"{len(elements)} elements model where numMod is {stated.strip()[:20]}"
        raise SourceError(str(path), found, "a whole file", "Copy it again.")
    models = tuple(_model(element, f"{path}: model {n}") for n, element in enumerate(elements, 1))
    return TextureModels(
        _text(root, "material", str(path))[:80],
        _number(root, "mu", str(path), least=0.0),
        _number(root, "SampleRate", str(path), least=100.0),
        models,
    )


class _PlainBuilder(ElementTree.TreeBuilder):
    """Builds a tree, and refuses a document type, which could declare entities."""

    def doctype(self, *_: object) -> None:
        raise ValueError("a document type declaration")


def _parse(path: Path) -> ElementTree.Element:
    data = read_bytes(path, _MAX_BYTES, _EXPECTED)
    try:
        root = ElementTree.fromstring(data, ElementTree.XMLParser(target=_PlainBuilder()))
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise SourceError(str(path), f"no XML ({error})", _EXPECTED) from error
    if root.tag != "modelSet":
        raise SourceError(str(path), f"the element {root.tag[:40]!r}", f"modelSet: {_EXPECTED}")
    return root


def _model(element: ElementTree.Element, where: str) -> TextureModel:
    ar = _numbers(element, "ARcoeff", where)
    has_ma = element.find("MAcoeff") is not None
    model = TextureModel(
        1e-3 * _number(element, "speedMod", where, least=0.0),
        _number(element, "forceMod", where, least=0.0),
        _number(element, "var", where, least=0.0),
        _number(element, "gain", where, least=0.0) if has_ma else 1.0,
        ar,
        _numbers(element, "MAcoeff", where) if has_ma else np.ones(1),
    )
    if ar[0] != 1:
        raise SourceError(f"{where}: ARcoeff", f"{ar[0]:g} as the first value", "1")
    if len(ar) > 1 and np.abs(np.roots(ar)).max(initial=0.0) >= 1:
        raise SourceError(f"{where}: ARcoeff", "an unstable filter", "all poles within the unit circle")
    return model


def _text(element: ElementTree.Element, name: str, where: str) -> str:
    text = (element.findtext(name) or "").strip()
    if not text:
        raise SourceError(f"{where}: {name}", "nothing", _EXPECTED)
    return text


def _number(element: ElementTree.Element, name: str, where: str, least: float) -> float:
    text = _text(element, name, where)
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not least <= value < 1e9:
        raise SourceError(f"{where}: {name}", repr(text[:40]), f"a number, {least:g} or more")
    return value


def _numbers(element: ElementTree.Element, name: str, where: str) -> Float64s:
    texts = [value.text or "" for value in element.findall(f"{name}/value")]
    if not 1 <= len(texts) <= _MAX_ORDER:
        raise SourceError(f"{where}: {name}", f"{len(texts)} values", f"1 to {_MAX_ORDER}")
    try:
        values = np.array([float(text) for text in texts])
    except ValueError as error:
        raise SourceError(f"{where}: {name}", str(error)[:60], "numbers") from error
    if not np.isfinite(values).all():
        raise SourceError(f"{where}: {name}", "a number that is not finite", "finite numbers")
    return values
