"""Random effects of arrays, and small HJIF documents, for tests."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import strategies as st

from touchfield.errors import TouchfieldError
from touchfield.exchange.hjif_import import force_n
from touchfield.exchange.hjif_read import read_hjif
from touchfield.exchange.symbolic import ArrayEffect

RATES_HZ = (1.0, 20.0, 25.0, 30.0, 50.0, 100.0, 1000 / 3)


@st.composite
def effects(draw: st.DrawFn, max_frames: int = 12, with_hertz: bool = True) -> ArrayEffect:
    """Random effects: some smooth, some silent, some with jumps."""
    shape = (draw(st.integers(1, max_frames)), draw(st.integers(1, 5)), draw(st.integers(1, 4)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    drives = rng.random(shape) * (rng.random(shape[1:]) < 0.7)
    if draw(st.booleans()):
        drives *= rng.random(shape) < 0.5
    if draw(st.booleans()):
        drives = np.linspace(0, 1, shape[0])[:, None, None] * drives[:1]
    hertz = None
    if with_hertz and draw(st.booleans()):
        hertz = np.where(drives > 0, rng.uniform(1, 900, shape), 0).astype(np.float32)
    return ArrayEffect(draw(st.sampled_from(RATES_HZ)), drives.astype(np.float32), hertz)


def keyframe(tick: int, amplitude: float | None = None, hertz: float | None = None) -> dict[str, Any]:
    values = {"relative_position": tick, "amplitude_modulation": amplitude, "frequency_modulation": hertz}
    return {key: value for key, value in values.items() if value is not None}


def effect(keyframes: list[dict[str, Any]], position: int = 0) -> dict[str, Any]:
    return {
        "effect_type": "Basis",
        "position": position,
        "phase": 0,
        "base_signal": "Sine",
        "keyframes": [dict(entry) for entry in keyframes],
    }


def band(kind: str, *effect_dicts: dict[str, Any], **more: Any) -> dict[str, Any]:
    limits = {"lower_frequency_limit": 0, "upper_frequency_limit": 1000}
    return {"band_type": kind, **limits, "effects": list(effect_dicts), **more}


def channel(*bands: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"id": 0, "description": "", "gain": 1.0, "mixing_coefficient": 1.0, "bands": list(bands), **more}


def document(*channels: dict[str, Any], modality: str = "Vibrotactile", **more: Any) -> dict[str, Any]:
    """A file with one perception; `more` goes into the perception."""
    perception = {
        "id": 0,
        "perception_modality": modality,
        "description": "",
        "avatar_id": 0,
        "effect_library": [],
        "channels": list(channels),
        **more,
    }
    return {
        "version": "2023",
        "profile": "Main",
        "level": 1,
        "date": "2026-01-01T00:00:00Z",
        "description": "",
        "timescale": 1000,
        "avatars": [],
        "perceptions": [perception],
        "syncs": [],
    }


def written(path: Path, content: Any) -> Path:
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def schema_errors(document: dict[str, Any], folder: Path) -> list[str]:
    """Violations of the published schemas by a document."""
    jsonschema, referencing = pytest.importorskip("jsonschema"), pytest.importorskip("referencing")
    from referencing.jsonschema import DRAFT4

    loaded = {path.name: json.loads(path.read_text(encoding="utf-8")) for path in folder.glob("*.json")}
    registry = referencing.Registry().with_resources(
        (name, referencing.Resource(contents=schema, specification=DRAFT4)) for name, schema in loaded.items()
    )
    validator = jsonschema.Draft4Validator(loaded["MPEG_haptics.schema.json"], registry=registry)
    return [f"{list(error.absolute_path)}: {error.message}" for error in validator.iter_errors(document)]


def key_paths(node: Any, prefix: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The keys and indices that lead to each value of a JSON document."""
    keys = list(node) if isinstance(node, dict) else list(range(len(node))) if isinstance(node, list) else []
    return [path for key in keys for path in ((*prefix, key), *key_paths(node[key], (*prefix, key)))]


def with_value(document: Any, keys: tuple[Any, ...], value: Any) -> Any:
    """A copy of a JSON document with another value where the keys and indices lead to."""
    changed = copy.deepcopy(document)
    inner = changed
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = value
    return changed


def check_error(reader: Callable[[Path], Any], path: Path) -> None:
    """Any error is one line that names the file."""
    found = None
    try:
        reader(path)
    except TouchfieldError as error:
        found = str(error)
    assert found is None or (path.name in found and "\n" not in found)


class TactSpan(NamedTuple):
    """Dots that are on during a time interval, milliseconds, float32 [5, 4]."""

    position: str
    start_ms: int
    end_ms: int
    intensities: np.ndarray


def read_tact(path: Path) -> list[TactSpan]:
    """The dots of a ``.tact`` file, sorted by their start."""
    spans = []
    for track in json.loads(path.read_text())["project"]["tracks"]:
        for effect in track["effects"]:
            for position, mode in effect["modes"].items():
                for span in mode["dotMode"]["feedback"]:
                    dots = np.zeros(20, np.float32)
                    for point in span["pointList"]:
                        assert 0 <= point["index"] < 20 and 0 <= point["intensity"] <= 1
                        dots[point["index"]] = point["intensity"]
                    start_ms = effect["startTime"]
                    span_ms = (start_ms + span["startTime"], start_ms + span["endTime"])
                    spans.append(TactSpan(position, *span_ms, dots.reshape(5, 4)))
    return sorted(
        (span for span in spans if span.intensities.any()), key=lambda span: (span.start_ms, span.position)
    )


def read_force(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The force at the keyframes of a file: ascending seconds [n], and newtons along x, y, z [n, 3]."""
    document = read_hjif(path)
    perception = next(
        (item for item in document.perceptions if item.modality == "Force"), document.perceptions[0]
    )
    tick_arrays = [
        np.zeros(1, np.int64)
    ]  # every tick at which a line starts or stops, and one tick after an effect
    for band in (band for channel in perception.channels for band in channel.bands):
        effects = [effect for effect in band.effects if len(effect.ticks)]
        tick_arrays += [effect.position + effect.ticks for effect in effects]
        tick_arrays += [item.position + item.ticks[-1:] + 1 for item in effects[:-1]]
    ticks = np.unique(np.concatenate(tick_arrays)).astype(np.float64)
    return ticks / document.timescale, force_n(perception, ticks)
