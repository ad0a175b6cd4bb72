"""Reading HJIF: the effect agrees with the document, and schema violations are one-line errors."""

from __future__ import annotations

import base64
import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from effect_makers import (
    band,
    channel,
    check_error,
    document,
    effect,
    key_paths,
    keyframe,
    read_force,
    written,
)
from touchfield.errors import InvalidArgument, SourceError
from touchfield.exchange import hjif_read
from touchfield.exchange.hjif_import import read_hjif_array
from touchfield.exchange.hjif_read import block_samples
from touchfield.exchange.symbolic import TRANSIENT_S, ImportedEffect


def read(path: Path, *channels: dict[str, Any], rate_hz: float = 100.0, **more: Any) -> ImportedEffect:
    return read_hjif_array(written(path / "a.hjif", document(*channels, **more)), rate_hz)


def drives(path: Path, *bands: dict[str, Any], rate_hz: float = 100.0, **more: Any) -> np.ndarray:
    return read(path, channel(*bands, **more), rate_hz=rate_hz).effect.drives[:, 0, 0]


LINE = [keyframe(0, 0.0, 100), keyframe(100, 1.0, 200)]


def test_wave_is_interpolated_between_keyframes(tmp_path: Path) -> None:
    result = read(tmp_path, channel(band("VectorialWave", effect(LINE)))).effect
    assert result.drives[:, 0, 0] == pytest.approx(np.arange(11) / 10)
    assert result.frequencies_hz is not None
    # no frequency without a drive
    assert result.frequencies_hz[:, 0, 0] == pytest.approx([0, *range(110, 201, 10)], rel=1e-6)


def test_later_effect_replaces_the_earlier_and_silence_follows(tmp_path: Path) -> None:
    wave = band(
        "VectorialWave", effect([keyframe(0, 1.0, 80), keyframe(100, 1.0)]), effect([keyframe(0, 0.25)], 50),
        effect([keyframe(0, 0.5), keyframe(10, 0.5)], 150),
    )  # fmt: skip
    assert drives(tmp_path, wave).tolist() == [1] * 5 + [0.25] + [0] * 9 + [0.5] * 2


def test_curves_are_magnitudes_linear_or_cubic(tmp_path: Path) -> None:
    points = [keyframe(0, -1.0), keyframe(100, 1.0), keyframe(200, 0.0)]
    linear = drives(tmp_path, band("Curve", effect(points), curve_type="Linear"))
    assert linear == pytest.approx(np.abs(np.interp(np.arange(21), [0, 10, 20], [-1, 1, 0])), abs=1e-6)
    eased = drives(tmp_path, band("Curve", effect(points), curve_type="Cubic"))
    assert eased[15] == pytest.approx(0.5) and eased[12] > linear[12] and eased[18] < linear[18]


def test_transients_decay_and_add(tmp_path: Path) -> None:
    found = drives(tmp_path, band("Transient", effect([keyframe(3, 0.5, 90), keyframe(100, 1.0, 90)])))
    assert found[0] == 0.5 and found[1] == pytest.approx(0.5 * (1 - 0.01 / TRANSIENT_S)) and found[3] == 0
    assert found[10] == 1 and found[12] > 0
    both = drives(
        tmp_path,
        band("Transient", effect([keyframe(0, 0.5)])),
        band("Transient", effect([keyframe(0, 0.25)])),
    )
    assert both[0] == 0.75


def test_effects_shorter_than_a_frame_are_included(tmp_path: Path) -> None:
    short = effect([keyframe(0, 0.1), keyframe(1, 0.9), keyframe(2, 0.2)], 24)
    assert drives(tmp_path, band("VectorialWave", short)).tolist() == pytest.approx([0, 0, 0.9])


def test_gain_mixing_and_the_sum_of_bands(tmp_path: Path) -> None:
    steady = band("VectorialWave", effect([keyframe(0, 0.4, 60), keyframe(10, 0.4)]))
    other = band("VectorialWave", effect([keyframe(0, 0.2, 250), keyframe(10, 0.2)]))
    result = read(tmp_path, channel(steady, other, gain=0.5, mixing_coefficient=2.0)).effect
    assert result.drives[:, 0, 0] == pytest.approx([0.6, 0.6]) and result.frequencies_hz is not None
    assert result.frequencies_hz[:, 0, 0].tolist() == [60, 60]  # the frequency of the stronger band
    assert drives(tmp_path, steady, gain=10.0).tolist() == [1, 1]


def steady(amplitude: float) -> dict[str, Any]:
    return band("VectorialWave", effect([keyframe(0, amplitude, 100), keyframe(10, amplitude)]))


def test_targets_count_columns_from_the_left_and_rows_from_the_bottom(tmp_path: Path) -> None:
    size = {"X": 3, "Y": 2, "Z": 1}
    result = read(
        tmp_path,
        channel(steady(0.25), actuator_resolution=size, actuator_target=[{"X": 2, "Y": 1, "Z": 0}]),
        channel(
            steady(0.5),
            actuator_resolution=size,
            actuator_target=[{"X": 0, "Y": 0, "Z": 0}, {"X": 1, "Y": 0, "Z": 0}],
        ),
    ).effect
    assert result.drives[0].tolist() == [[0, 0, 0.25], [0.5, 0.5, 0]]
    for x, y, z in ((3, 0, 0), (0, 2, 0), (0, 0, 1)):
        target = [{"X": 0, "Y": 0, "Z": 0}, {"X": x, "Y": y, "Z": z}]
        with pytest.raises(SourceError, match=r"actuator_target\[1\]: .*within 3 x 2 x 1"):
            read(tmp_path, channel(steady(0.5), actuator_resolution=size, actuator_target=target))
    all_targets = read(tmp_path, channel(steady(0.5), actuator_resolution=size)).effect
    assert (all_targets.drives == 0.5).all() and all_targets.lattice == (3, 2, 1)


def test_channels_without_an_array_form_a_row_and_body_parts_are_adjacent(tmp_path: Path) -> None:
    assert read(tmp_path, channel(steady(0.25)), channel(steady(0.5))).effect.drives[0].tolist() == [
        [0.25, 0.5]
    ]
    result = read(
        tmp_path,
        channel(
            steady(0.25), body_part_target=["Chest", "Front"], actuator_target=[{"X": 0, "Y": 1, "Z": 0}]
        ),
        channel(steady(0.5), body_part_target=["Chest", "Back"]),
        channel(steady(0.75), body_part_target=["Chest", "Back"]),
    )
    assert result.effect.drives[0].tolist() == [[0.25, 0, 0], [0, 0.5, 0.75]]
    assert "2 body parts" in result.notes[0]


def test_overlapping_channels_add_and_the_strongest_sets_the_frequency(tmp_path: Path) -> None:
    def wave(amplitude: float, hertz: float) -> dict[str, Any]:
        result = effect([keyframe(0, amplitude, hertz), keyframe(10, amplitude, hertz)])
        return channel(band("VectorialWave", result), actuator_target=[{"X": 0, "Y": 0, "Z": 0}])

    result = read(tmp_path, wave(0.5, 100), wave(0.4, 200), wave(0.45, 300)).effect
    assert result.drives.tolist() == [[[1]], [[1]]] and result.frequencies_hz is not None
    assert (result.frequencies_hz == 100).all()


def test_thousands_of_channels_form_a_row(tmp_path: Path) -> None:
    result = read(tmp_path, *[channel(steady(0.5))] * 5000).effect
    assert result.lattice == (5000, 1, 1) and (result.drives == 0.5).all()


def test_unsupported_perceptions_are_ignored_or_refused(tmp_path: Path) -> None:
    both = document(channel(steady(0.5)))
    both["perceptions"].insert(0, document(channel(steady(1.0)), modality="Temperature")["perceptions"][0])
    result = read_hjif_array(written(tmp_path / "b.hjif", both))
    assert result.effect.drives[0, 0, 0] == 0.5 and "Temperature" in result.notes[0]
    both["perceptions"].insert(0, document(channel(steady(1.0)), modality="Other")["perceptions"][0])
    del both["timescale"]  # the default is a millisecond
    result = read_hjif_array(written(tmp_path / "b.hjif", both))
    assert result.effect.drives[:, 0, 0].tolist() == [0.5, 0.5] and "Other, Temperature" in result.notes[0]
    with pytest.raises(SourceError, match="Temperature"):
        read(tmp_path, channel(steady(1.0)), modality="Temperature")


def force_channel(
    direction: tuple[int, int, int], *points: dict[str, Any], gain: float = 0.5
) -> dict[str, Any]:
    x, y, z = direction
    return channel(band("Curve", effect(list(points))), gain=gain, direction={"X": x, "Y": y, "Z": z})


def test_a_force_along_any_direction(tmp_path: Path) -> None:
    force_document = document(
        force_channel((127, 0, 0), keyframe(0, 1.0), keyframe(100, -1.0)),
        force_channel((0, -90, 90), keyframe(0, 0.0), keyframe(50, 1.0), keyframe(100, 0.0)),
        modality="Force", perception_unit_exponent=1,
    )  # fmt: skip
    times, forces = read_force(written(tmp_path / "f.hjif", force_document))
    assert times.tolist() == [0, 0.05, 0.1]
    assert forces == pytest.approx(np.array([[5, 0, 0], [0, -3.5355, 3.5355], [-5, 0, 0]]), abs=1e-4)
    imported = read_hjif_array(tmp_path / "f.hjif")
    assert imported.force_max_n == 5 and imported.effect.drives[[0, 5, 10], 0, 0] == pytest.approx(
        [1, 1, 1], abs=1e-6
    )
    assert imported.effect.drives[2, 0, 0] == pytest.approx(np.hypot(0.6, 0.4))
    bare = channel(steady(0.5))
    with pytest.raises(SourceError, match="direction"):
        read_force(written(tmp_path / "g.hjif", document(bare, modality="Force")))
    directed = channel(steady(0.5), direction={"X": 127, "Y": 0, "Z": 0})
    # actuators, as there is no direction
    assert read(tmp_path, bare, modality="Force").effect.drives[0, 0, 0] == 0.5
    assert read(tmp_path, directed).effect.drives[0, 0, 0] == 0.5  # a vibration ignores the direction
    mighty = force_channel((127, 0, 0), keyframe(0, 1.0), keyframe(10, 1.0), gain=1.1e6)
    with pytest.raises(SourceError, match="a greatest force of"):
        read(tmp_path, mighty, modality="Force")
    # its curve starts with the effect
    later = effect([keyframe(0, 1.0), keyframe(10, 0.5), keyframe(20, 1.0)], 40)
    force_document["perceptions"][0]["channels"] = [
        channel(band("Curve", later), direction={"X": 0, "Y": 0, "Z": 127})
    ]
    assert read_hjif_array(written(tmp_path / "f.hjif", force_document)).effect.drives[
        3:, 0, 0
    ] == pytest.approx([0, 1, 0.5, 1])
    wave = document(channel(steady(1.0), direction={"X": 127, "Y": 0, "Z": 0}), modality="Force")
    with pytest.raises(SourceError, match=r"bands\[0\].*Curve"):
        read_force(written(tmp_path / "g.hjif", wave))


def test_vibration_sampled_by_a_curve_has_its_frequency(tmp_path: Path) -> None:
    points = [keyframe(n, 0.5 * np.sin(2 * np.pi * 50 * n / 1000)) for n in range(0, 1000, 2)]
    for kind in ("Linear", "Cubic"):
        result = read(tmp_path, channel(band("Curve", effect(points), curve_type=kind))).effect
        assert result.frequencies_hz is not None
        assert result.drives[5:95, 0, 0] == pytest.approx(0.5, abs=0.03)
        assert result.frequencies_hz[5:95, 0, 0] == pytest.approx(50, rel=0.02)
    ramp = read(tmp_path, channel(band("Curve", effect([keyframe(0, 0.0), keyframe(500, 1.0)]))))
    assert ramp.effect.frequencies_hz is None and "no frequency of its own" in ramp.notes[0]


# a sine of 200 Hz and 0.6 in blocks of 64 at 1 kHz, coded by the reference encoder; 7 bit planes
BLOCKS = (
    "c74800643dd4ae76bcf880035af04ad119389999cca7d3d2950038a13da51f52533f2ddff5e431cacbafbd19173a9f12d2f4b3d885996d335"
    "76a05",
    "a70400644a4af89a1b3b3920f78af294b0a64aa51e97e129ef9afb7e7b5990e516e5b70800fa51a8a2ff5409feafba8e69af0200908763e785"
    "0140d8",
)


def wavelets(*streams: str, **more: Any) -> dict[str, Any]:
    effects = [
        {
            "effect_type": "Basis",
            "position": 64 * n,
            "wavelet_stream": base64.b64encode(bytes.fromhex(stream)).decode(),
        }
        for n, stream in enumerate(streams)
    ]
    wave_band: dict[str, Any] = {
        "block_length": 64,
        "lower_frequency_limit": 72,
        "upper_frequency_limit": 1000,
        **more,
    }
    return {**band("WaveletWave", *effects), **wave_band}


def test_wavelet_blocks_decode_to_the_coded_samples() -> None:
    found = np.concatenate([block_samples(bytes.fromhex(block), 64) for block in BLOCKS])
    expected = 0.6 * np.sin(2 * np.pi * 200 * np.arange(128) / 1000)
    assert np.abs(found - expected).max() < 0.01
    # value of the reference decoder, which rounds to 6 digits
    assert found[1] == pytest.approx(0.572778, abs=1e-6)
    assert not block_samples(b"", 64).any()


def test_wavelets_preserve_strength_and_frequency(tmp_path: Path) -> None:
    result = read(tmp_path, channel(wavelets(*BLOCKS, "")), modality="Other")
    assert result.effect.frequencies_hz is not None and "Other" in result.notes[0]
    assert result.effect.drives[1:12, 0, 0] == pytest.approx(0.57, abs=0.03)
    assert result.effect.frequencies_hz[1:12, 0, 0] == pytest.approx(200, abs=2)
    assert not result.effect.drives[14:].any()


@given(st.binary(max_size=300), st.sampled_from([16, 64, 1024]))
def test_any_bytes_are_a_block_of_finite_samples(stream: bytes, length: int) -> None:
    found = block_samples(stream, length)
    assert found.shape == (length,) and np.isfinite(found).all()


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"block_length": 63}, "block_length: found 63 ticks"),
        ({"upper_frequency_limit": 10000, "block_length": 6400}, "power of two"),
        ({"effects": [{"effect_type": "Basis", "wavelet_stream": "#"}]}, "wavelet_stream"),
        ({"effects": [{"effect_type": "Basis", "wavelet_stream": ""}] * 40000}, "40000 blocks"),
        ({"effects": [{"effect_type": "Basis"}]}, "no 'wavelet_stream'"),
    ],
)
def test_invalid_wavelets_are_refused(tmp_path: Path, more: dict[str, Any], message: str) -> None:
    with pytest.raises(SourceError, match=message):
        read(tmp_path, channel(wavelets(*BLOCKS, **more)))


# -- what is wrong with a file -----------------------------------------------------------------------------

P, C = ("perceptions", 0), ("perceptions", 0, "channels", 0)
B = (*C, "bands", 0)
E = (*B, "effects", 0)
K = (*E, "keyframes", 1)
NONE = object()

FAULTS: list[tuple[tuple[Any, ...], Any, str]] = [
    (("perceptions",), NONE, "$: found no 'perceptions'"),
    (("timescale",), 0, "$.timescale"),
    (("timescale",), 10**6, "$.timescale"),
    (("perceptions",), [], "$.perceptions"),
    ((*P, "perception_modality"), "Smell", "$.perceptions[0].perception_modality"),
    ((*P, "channels"), [], "$.perceptions[0].channels"),
    ((*C, "gain"), -1, "$.perceptions[0].channels[0].gain"),
    ((*C, "gain"), "1", "$.perceptions[0].channels[0].gain"),
    ((*C, "gain"), True, "$.perceptions[0].channels[0].gain"),
    ((*C, "body_part_mask"), 1 << 32, "body_part_mask"),
    ((*C, "actuator_resolution"), {"X": 2, "Y": 2, "Z": 2}, "actuator_resolution"),
    ((*C, "actuator_resolution"), {"X": 2, "Y": 128, "Z": 1}, "actuator_resolution.Y"),
    ((*C, "actuator_target"), [{"X": -1, "Y": 0, "Z": 0}], "actuator_target[0].X"),
    ((*C, "direction"), [1, 0, 0], "direction"),
    ((*B, "band_type"), "WaveletWave", "channels[0].bands[0]: found no 'block_length'"),
    ((*B, "lower_frequency_limit"), 20000, "bands[0].lower_frequency_limit"),
    ((*B, "lower_frequency_limit"), 5000, "bands[0]: found limits"),
    ((*E, "effect_type"), "Reference", "effects[0]: found an effect of type Reference"),
    ((*E, "effect_type"), "Composite", "effects[0]"),
    ((*E, "position"), 0.5, "effects[0].position"),
    ((*E, "position"), -1, "effects[0].position"),
    ((*E, "position"), 10**7, "an effect of 10000.1 s"),
    ((*E, "keyframes"), {}, "effects[0].keyframes"),
    (K, 3, "keyframes[1]"),
    ((*K, "relative_position"), 1.5, "keyframes[1].relative_position"),
    ((*K, "relative_position"), -1, "keyframes[1].relative_position"),
    ((*K, "amplitude_modulation"), 1.5, "keyframes[1].amplitude_modulation"),
    ((*K, "amplitude_modulation"), None, "keyframes[1].amplitude_modulation"),
    ((*K, "frequency_modulation"), 10001, "keyframes[1].frequency_modulation"),
]


def faulty_document(keys: tuple[Any, ...], value: Any) -> dict[str, Any]:
    faulty = document(channel(band("VectorialWave", effect(LINE))))
    inner: Any = faulty
    for key in keys[:-1]:
        inner = inner[key]
    if value is NONE:
        del inner[keys[-1]]
    else:
        inner[keys[-1]] = value
    return faulty


@pytest.mark.parametrize(("keys", "value", "message"), FAULTS)
def test_schema_violations_are_named(tmp_path: Path, keys: tuple[Any, ...], value: Any, message: str) -> None:
    with pytest.raises(SourceError) as caught:
        read_hjif_array(written(tmp_path / "a.hjif", faulty_document(keys, value)))
    assert message in str(caught.value) and "a.hjif" in str(caught.value) and "\n" not in str(caught.value)


def test_ambiguous_curve_types_are_refused(tmp_path: Path) -> None:
    for kind in ("Bezier", "BSpline"):
        with pytest.raises(SourceError, match=kind):
            drives(tmp_path, band("Curve", effect(LINE), curve_type=kind))


def test_akima_curve_passes_its_points_and_does_not_overshoot(tmp_path: Path) -> None:
    points = [keyframe(100 * n, float(n > 2)) for n in range(7)]
    found = drives(tmp_path, band("Curve", effect(points), curve_type="Akima"), rate_hz=100.0)
    assert found[::10] == pytest.approx([0, 0, 0, 1, 1, 1, 1]) and found[25] == pytest.approx(0.5)
    assert found[:20].max() == 0 and found[31:].min() == 1


def test_keyframes_out_of_order(tmp_path: Path) -> None:
    with pytest.raises(
        SourceError, match=r"keyframes\[1\].relative_position: found 5; expected a tick not before 10"
    ):
        drives(tmp_path, band("Curve", effect([keyframe(10, 0.0), keyframe(5, 0.0)])))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "nonsense",
        "[" * 100_000,
        '{"version": NaN}',
        '{"version": ' + "9" * 5000 + "}",
        "[]",
        "3",
        "\ud800",
    ],
)
def test_invalid_files_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.hjif").write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(SourceError, match=r"a\.hjif"):
        read_hjif_array(tmp_path / "a.hjif")


def test_missing_or_too_long_files_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SourceError, match="no such file"):
        read_hjif_array(tmp_path / "none.hjif")
    monkeypatch.setattr(hjif_read, "MAX_CHANNELS", 1)
    with pytest.raises(SourceError, match="found 2 channels; expected at most 1"):
        read(tmp_path, channel(steady(0.5)), channel(steady(0.5)))
    monkeypatch.setattr(hjif_read, "MAX_BYTES", 10)
    with pytest.raises(SourceError, match="more than 10 bytes"):
        drives(tmp_path, band("Curve", effect(LINE)))


def test_small_files_with_huge_effects_are_refused(tmp_path: Path) -> None:
    size = {"X": 127, "Y": 127, "Z": 1}
    long = band("VectorialWave", effect([keyframe(0, 1.0), keyframe(3_000_000, 1.0)]))
    with pytest.raises(SourceError, match="16129 actuators"):
        read(tmp_path, channel(long, actuator_resolution=size))
    with pytest.raises(SourceError, match="at most 16777216 drives"):
        read(tmp_path, *[channel(actuator_resolution=size) for _ in range(1100)])
    with pytest.raises(SourceError, match="bands at"):
        read(tmp_path, channel(long, *[band("Curve") for _ in range(1000)]))
    with pytest.raises(InvalidArgument, match="rate_hz"):
        read(tmp_path, channel(long), rate_hz=1e6)


VALUES = st.sampled_from([None, True, -1, 0, 1, 0.5, 1e308, 10**30, "", "Curve", "Basis", [], {}, [[]], [{}]])


WAVES = band("VectorialWave", effect(LINE)), band("Transient", effect(LINE))
CURVE = band("Curve", effect(LINE), curve_type="Cubic")
FULL = document(
    channel(*WAVES, actuator_target=[{"X": 0, "Y": 0, "Z": 0}]),
    channel(CURVE, direction={"X": 0, "Y": 0, "Z": 127}),
    modality="Force",
    perception_unit_exponent=0,
    reference_devices=[{"id": 1, "name": "a"}],
)
KEY_PATHS = key_paths(FULL)


@given(keys=st.sampled_from(KEY_PATHS), value=VALUES, is_removed=st.booleans())
def test_only_named_errors_are_raised(
    tmp_path_factory: pytest.TempPathFactory, keys: tuple[Any, ...], value: Any, is_removed: bool
) -> None:
    faulty = copy.deepcopy(FULL)
    inner: Any = faulty
    for key in keys[:-1]:
        inner = inner[key]
    if is_removed:
        del inner[keys[-1]]
    else:
        inner[keys[-1]] = value
    path = written(tmp_path_factory.mktemp("hjif") / "a.hjif", faulty)
    for reader in (read_hjif_array, read_force):
        check_error(reader, path)


@given(cut=st.integers(0, 400), data=st.binary(max_size=8))
def test_damaged_bytes_raise_named_errors_only(
    tmp_path_factory: pytest.TempPathFactory, cut: int, data: bytes
) -> None:
    valid = json.dumps(FULL).encode()
    path = tmp_path_factory.mktemp("hjif") / "a.hjif"
    path.write_bytes(valid[:cut] + data + valid[cut + len(data) :])
    check_error(read_hjif_array, path)
