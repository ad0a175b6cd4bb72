"""The binary form of MPEG haptics: the parsed document agrees with HJIF, and damage raises named errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from effect_makers import read_force
from hmpg_makers import FILE, LINEAR, Fields, band, channel, curve, head, pack, packet, quantised, unit
from touchfield.errors import SourceError
from touchfield.exchange.hjif_import import read_hjif_array
from touchfield.exchange.hjif_read import read_hjif


def write(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def test_effect_in_several_units(tmp_path: Path) -> None:
    result = read_hjif_array(write(tmp_path / "a.hmpg", FILE))
    assert result.device_name == "vest"
    assert result.effect.drives[:, 0, 0] == pytest.approx(
        np.abs(np.interp(np.arange(43), [1.99, 2, 12, 32, 42], [0, 0.5, 0.25, 0.5, -0.5])), abs=0.005
    )


@pytest.mark.parametrize(("kind", "start_frame"), [(1, 15), (2, 2)])
def test_effect_positions_are_relative_to_their_unit(tmp_path: Path, kind: int, start_frame: int) -> None:
    preamble = head(6, channel(0, 1.0), band(0, 0, 1, LINEAR), packet(6, [(0, 24)]))  # with an empty library
    data = preamble + unit(kind, 128) + unit(kind, 128, curve(22, (0, 1.0)))
    result = read_hjif_array(write(tmp_path / "a.hmpg", data))
    assert np.flatnonzero(result.effect.drives).tolist() == [start_frame]


def test_numbers_map_to_the_names_of_the_standard(tmp_path: Path) -> None:
    modalities = (
        "Other",
        "Pressure",
        "Acceleration",
        "Velocity",
        "Position",
        "Temperature",
        "Vibrotactile",
        "Water",
        "Wind",
        "Force",
        "Vibrotactile Texture",
        "Stiffness",
        "Friction",
        "Electrotactile",
    )
    for number, modality in enumerate(modalities):
        data = head(
            number, channel(0, 1.0), *(band(n, 0, 1, [(n, 4)]) for n in (0, 1, 2, 3)), band(9, 0, 0, [])
        )
        (perception,) = read_hjif(write(tmp_path / "a.hmpg", data)).perceptions
        assert perception.modality == modality
        shapes = [(band_read.kind, band_read.curve) for band_read in perception.channels[0].bands]
        assert shapes == [
            *(("Curve", shape) for shape in ("Unknown", "Cubic", "Linear", "Akima")),
            ("Transient", "Linear"),
        ]
    for number, shape in ((4, "Bezier"), (5, "BSpline")):  # which decoders draw differently
        data = head(6, channel(0, 1.0), band(0, 0, 1, [(number, 4)]))
        with pytest.raises(SourceError, match=f"a curve of type {shape}"):
            read_hjif(write(tmp_path / "a.hmpg", data))
    (perception,) = read_hjif(write(tmp_path / "a.hmpg", head(6, channel(0, -0.5)))).perceptions
    assert perception.channels[0].gain == 0
    with pytest.raises(SourceError, match="a modality of number 14"):
        read_hjif(write(tmp_path / "a.hmpg", head(14, channel(0, 1.0))))


def test_force_is_read_with_its_gain(tmp_path: Path) -> None:
    data = head(9, channel(0, 0.02, (0, -127, 0)), band(0, 0, 1, LINEAR)) + unit(
        1, 128, curve(0, (0, -1.0), (90, 1.0))
    )
    times, forces = read_force(write(tmp_path / "f.hmpg", data))
    assert times.tolist() == [0, 0.09] and forces[:, 1] == pytest.approx([0.02, -0.02], abs=1e-5)


def test_wavelets_and_waves(tmp_path: Path) -> None:
    stream = bytes.fromhex(
        "c74800643dd4ae76bcf880035af04ad119389999cca7d3d2950038a13da51f52533f2ddff5e431cacbafbd19"
    )
    block = [(0, 1), (0, 8), (0, 16), (0, 8), (1, 16), (0, 16), (0, 2), (0, 1), (len(stream), 16)]
    data = packet(5, [*block, *((byte, 8) for byte in stream)])
    waves = head(6, channel(0, 1.0), band(0, 0, 3, [(64, 8)])) + unit(1, 128, data, data)
    result = read_hjif_array(write(tmp_path / "w.hmpg", waves)).effect
    assert result.frequencies_hz is not None and result.frequencies_hz[3, 0, 0] == pytest.approx(200, abs=5)
    assert len(result.drives) == 13 and result.drives[2:12].min() > 0.4  # one block after the other
    keyframes: Fields = [(3, 2), quantised(0.6, -1, 1, 8), (0, 16), (80, 16), (2, 2), (50, 16), (120, 16)]
    fields = [
        (0, 1),
        (0, 8),
        (0, 16),
        (0, 8),
        (1, 16),
        (0, 16),
        (0, 2),
        (0, 25),
        (0, 1),
        (2, 16),
        (0, 16),
        (1, 4),
    ]
    wave = head(6, channel(0, 1.0), band(0, 0, 2, [])) + unit(1, 128, packet(5, [*fields, *keyframes]))
    second_result = read_hjif_array(write(tmp_path / "v.hmpg", wave)).effect
    assert second_result.frequencies_hz is not None and second_result.frequencies_hz[
        :, 0, 0
    ] == pytest.approx(np.arange(80, 121, 8))
    assert second_result.drives == pytest.approx(0.6, abs=0.005)
    taps = [quantised(0.6, -1, 1, 8), (0, 16), (80, 16), quantised(0.3, -1, 1, 8), (50, 16), (10001, 16)]
    fields = [(0, 1), (0, 8), (0, 16), (0, 8), (1, 16), (0, 16), (0, 2), (0, 25), (0, 1), (2, 16)]
    tap = head(6, channel(0, 1.0), band(0, 0, 0, [])) + unit(1, 128, packet(5, [*fields, *taps]))
    second_result = read_hjif_array(write(tmp_path / "t.hmpg", tap)).effect
    assert second_result.frequencies_hz is not None and second_result.frequencies_hz[
        [0, 5], 0, 0
    ].tolist() == [80, 10000]
    assert second_result.drives[[0, 5], 0, 0] == pytest.approx([0.6, 0.3], abs=0.005)


REFERENCE = packet(5, [(0, 1), (0, 8), (0, 16), (0, 8), (1, 16), (7, 16), (1, 2), (0, 25)])
"""Effect 7, which only names another one."""


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (FILE[:-1], "its length"),
        (b"{}", "bits left"),
        (b"", "no perception"),
        (head(99), "a modality of number 99"),
        (unit(0, 0, channel(0, 1.0)), "a channel of perception 0"),
        (head(6, band(0, 3, 1, LINEAR)), "a band of channel 3"),
        (head(6, channel(0, 1.0), band(0, 0, 6, [])), "a band of type 6"),
        (head(6, channel(0, 1.0)) + unit(1, 1, curve(0, (0, 1.0))), "effects of band 0"),
        (
            head(6, channel(0, 1.0), band(0, 0, 1, LINEAR)) + unit(1, 1, REFERENCE, curve(0, (0, 1.0))),
            "key frames of effect 7",
        ),
        (unit(0, 0, pack([(1, 6), (9, 17), (0, 1)])), "packet's length"),
        (unit(0, 0, packet(2, [(9, 8)])), "8 more"),
    ],
)
def test_damage_is_named(tmp_path: Path, data: bytes, message: str) -> None:
    with pytest.raises(SourceError, match=r"a\.hmpg") as caught:
        read_hjif_array(write(tmp_path / "a.hmpg", data))
    assert message in str(caught.value) and "\n" not in str(caught.value)


@given(at=st.integers(0, len(FILE) - 1), value=st.integers(0, 255))
def test_a_changed_byte_gives_an_effect_or_an_error(
    tmp_path_factory: pytest.TempPathFactory, at: int, value: int
) -> None:
    data = bytearray(FILE)
    data[at] = value
    try:
        found = read_hjif_array(write(tmp_path_factory.mktemp("hmpg") / "a.hmpg", bytes(data)))
    except SourceError:
        return
    assert np.isfinite(found.effect.drives).all()
