"""All efforts write the same bytes and satisfy the same error bound."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from field_makers import hills, round_trip
from test_random_error_bound import check_bound

from touchfield.codec.touch.body import BodyReader
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import EFFORTS, TouchSpec
from touchfield.medium import ForceField
from touchfield.pipeline import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.options import SourceOptions


def rough(lift: float) -> ForceField:
    rng = np.random.default_rng(1)
    dense = hills(17, 4, lift).to_dense()
    dense += np.where(dense != 0, rng.normal(0, 0.15, dense.shape), 0).astype(np.float32)
    return ForceField.from_dense(hills(17).grid, dense)


def walls(count: int) -> list[ForceField]:
    return [hills(24, 5, 0.7 * i) for i in range(count)]


@pytest.mark.parametrize("name", ["wall", "solid", "rough", "standing"])
def test_efforts_write_the_same_bytes(name: str) -> None:
    frames = {
        "wall": walls(2),
        "solid": [hills(24, None, 0.7 * i) for i in range(2)],
        "rough": [rough(0.0), rough(0.4)],
        "standing": [hills(24, 5)] * 3,
    }[name]
    bodies = set()
    for effort in EFFORTS:
        body, _, decoded = round_trip(frames, TouchSpec(effort=effort))
        assert len(decoded) == len(frames)
        bodies.add(body)
    assert len(bodies) == 1


@pytest.mark.parametrize("mode", ["mask", "mask-direction", "nmse"])
def test_decoder_does_not_need_the_effort(mode: str) -> None:
    frames = walls(2)
    for effort in EFFORTS:
        spec = TouchSpec(effort=effort, mode=mode)
        body, _, decoded = round_trip(frames, spec)
        for other in EFFORTS:
            parameters = TouchEncoder(frames[0].grid, replace(spec, effort=other)).parameters
            assert list(TouchDecoder(frames[0].grid, parameters).frames(body, 2)) == decoded


@pytest.mark.parametrize("effort", EFFORTS)
def test_solid_has_a_base_layer(effort: str) -> None:
    sizes = []
    for guess in ("auto", "off"):
        spec = TouchSpec(effort=effort, guess=guess)
        check_bound([hills(40)], spec)
        body, decoder, _ = round_trip([hills(40)], spec)
        (record,) = BodyReader(body, hills(40).grid, exact=False).records(1)
        (cost,) = decoder.costs(body, 1)
        assert bool(record.base_layer) == (cost.bits.models > 0) == (guess == "auto")
        sizes.append(len(body))
    assert sizes[0] < sizes[1]


def test_static_surface_has_no_second_base_layer() -> None:
    body, decoder, _ = round_trip([hills(40), hills(40)], TouchSpec())
    first, second = decoder.costs(body, 2)
    assert second.bits.models == 0 and second.bits.total < 0.1 * first.bits.total


@pytest.fixture(scope="module")
def recorded_fields(shared_data: Path) -> dict[tuple[str, str], list[ForceField]]:
    """Two frames of each recorded sequence, as bands and as height fields."""
    fields = {}
    for name in ("rgbd_tum_fr1_rpy", "rgbd_iclnuim_livingroom1"):
        for reading in ("band", "height"):
            source = SourceOptions() if reading == "band" else SourceOptions(reading="height")
            spec = EncodeSpec(nw=6, frames=(0, 2), source=source)
            fields[name, reading] = list(prepare(shared_data / name, spec).medium)
    return fields


@pytest.mark.shared
@pytest.mark.parametrize("effort", EFFORTS)
@pytest.mark.parametrize("k", [0.05, 0.25])
def test_recorded_fields_satisfy_the_bound(
    recorded_fields: dict[tuple[str, str], list[ForceField]], effort: str, k: float
) -> None:
    assert recorded_fields and all(recorded_fields.values())
    for frames in recorded_fields.values():
        check_bound(frames, TouchSpec(effort=effort, k=k))
