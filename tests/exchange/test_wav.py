"""Drives as PCM: amplitude and frequency of one channel per actuator."""

from __future__ import annotations

import wave
from pathlib import Path

import numpy as np
import pytest

from touchfield.errors import InvalidArgument
from touchfield.exchange.effect_files import RATE_HZ, write_wav, write_wav_array
from touchfield.exchange.symbolic import ArrayEffect


def read_samples(path: Path) -> np.ndarray:
    with wave.open(str(path)) as file:
        assert file.getframerate() == RATE_HZ and file.getsampwidth() == 2
        return np.frombuffer(file.readframes(1 << 24), "<i2").reshape(-1, file.getnchannels()) / 32767


def pitch_hz(samples: np.ndarray) -> float:
    spectrum = np.abs(np.fft.rfft(samples * np.hanning(len(samples)), 1 << 17))
    return float(np.argmax(spectrum) * RATE_HZ / (1 << 17))


def test_actuators_become_sines_of_their_drive_and_frequency(tmp_path: Path) -> None:
    drives = np.zeros((11, 2, 2), np.float32)
    drives[:] = [[0.25, 0.5], [1.0, 0.0]]
    hertz = np.zeros_like(drives)
    hertz[:] = [[80, 250], [1000, 0]]
    assert write_wav_array(tmp_path / "a.wav", ArrayEffect(10.0, drives, hertz)) == ()
    found = read_samples(tmp_path / "a.wav")
    assert found.shape == (8001, 4) and not found[:, 3].any()
    for channel, (amplitude, pitch) in enumerate([(0.25, 80), (0.5, 250), (1.0, 1000)]):
        assert np.abs(found[:, channel]).max() == pytest.approx(amplitude, abs=0.01)
        assert pitch_hz(found[:, channel]) == pytest.approx(pitch, abs=0.5)


def test_changing_frequency_has_no_jump_and_too_high_is_noted(tmp_path: Path) -> None:
    drives, hertz = (
        np.ones((100, 1, 1), np.float32),
        np.linspace(50, 200, 100, dtype=np.float32).reshape(-1, 1, 1),
    )
    hertz[40:60] = 0  # unknown: as before
    write_wav_array(tmp_path / "a.wav", ArrayEffect(20.0, drives, hertz))
    assert np.abs(np.diff(read_samples(tmp_path / "a.wav")[:, 0])).max() < 2 * np.pi * 201 / RATE_HZ
    fast = ArrayEffect(20.0, drives, np.full_like(hertz, 5000))
    assert "3600 Hz" in write_wav_array(tmp_path / "b.wav", fast)[0]
    assert pitch_hz(read_samples(tmp_path / "b.wav")[:, 0]) == pytest.approx(3600, abs=1)


def test_chunks_are_continuous(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    effect = ArrayEffect(20.0, np.random.default_rng(0).random((10, 2, 2)).astype(np.float32))
    write_wav_array(tmp_path / "a.wav", effect)
    monkeypatch.setattr("touchfield.exchange.effect_files._CHUNK_SAMPLES", 100)
    write_wav_array(tmp_path / "b.wav", effect)
    assert np.abs(read_samples(tmp_path / "a.wav") - read_samples(tmp_path / "b.wav")).max() < 1e-4


def test_samples_beyond_full_scale_are_clipped(tmp_path: Path) -> None:
    write_wav(tmp_path / "a.wav", [np.array([[1.5], [-1.5], [0.5]])], 1, 3)
    assert read_samples(tmp_path / "a.wav")[:, 0] == pytest.approx([1, -1, 0.5], abs=1e-4)


def test_invalid_sounds_are_refused(tmp_path: Path) -> None:
    for channels, count in ((0, 1), (5000, 1), (1024, 1 << 20)):
        with pytest.raises(InvalidArgument, match="channels"):
            write_wav(tmp_path / "a.wav", [], channels, count)
    assert list(tmp_path.iterdir()) == []
