"""Logs of `play` as MCAP: read back by the library, by the schemas in the file, and as recorded contacts."""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from touchfield.cli.main import _exit_code
from touchfield.medium.trace import read_contacts
from touchfield.pipeline import encode
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.block import COLUMNS, FLAGS
from touchfield.sources.recordings.contact_trace import read_mcap
from touchfield.sources.tiny_scenes import tiny_scenes
from touchfield.tasks.mcap_schemas import ARROW_TOPIC, POSE_TOPIC, TICK_TOPIC
from touchfield.tasks.play_mcap import ARROW_M_PER_N, ARROWS_HZ, write_mcap

reader = pytest.importorskip("mcap.reader", reason="needs the extra mcap")
MIRROR = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Exchanges x and y: a mirror, as of a device whose axes are named in the other order."""


def messages_of(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Times, nanoseconds, and contents of the messages of each topic; each is valid by its schema."""
    jsonschema = pytest.importorskip("jsonschema", reason="checks the messages")
    messages = defaultdict(list)
    validators: dict[int, Any] = {}
    with path.open("rb") as file:
        for schema, channel, message in reader.make_reader(file).iter_messages():
            content = json.loads(message.data)
            if schema.id not in validators:
                validators[schema.id] = jsonschema.Draft202012Validator(json.loads(schema.data))
            validators[schema.id].validate(content)
            messages[channel.topic].append((message.log_time, content))
    return messages


def vectors(messages: list[tuple[int, Any]], *keys: str, axes: str = "xyz") -> np.ndarray:
    """The vectors at the end of some keys, float64 [n, 3]."""
    rows = []
    for _, content in messages:
        inner = content
        for key in keys:
            inner = inner[key]
        rows.append([inner[axis] for axis in axes])
    return np.array(rows)


def random_rows(count: int) -> np.ndarray:
    rng, rows = np.random.default_rng(4), np.zeros(count, COLUMNS)
    for name in COLUMNS.names:
        if COLUMNS[name].base.kind == "f":
            rows[name] = rng.normal(size=rows[name].shape)
    rows["orientation"] /= np.linalg.norm(rows["orientation"], axis=1, keepdims=True)
    rows["time_s"] = np.arange(count) / 1000
    rows["buttons"], rows["flags"] = np.arange(count) % 4, FLAGS["running"] | FLAGS["stalled"]
    return rows


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mcap") / "tiny.touch"
    encode(tiny_scenes()[1], path, EncodeSpec(nw=4))
    return path


def test_values_are_those_of_the_log(tmp_path: Path) -> None:
    rows, path = random_rows(300), tmp_path / "a.mcap"
    assert write_mcap(path, rows, np.eye(3)) == ()
    read = messages_of(path)
    poses, ticks = read[POSE_TOPIC], read[TICK_TOPIC]
    assert [time for time, _ in poses] == [time for time, _ in ticks] == [n * 10**6 for n in range(300)]
    for time_ns, content in (*poses, *ticks):
        stamp = content["timestamp"]
        assert stamp["sec"] * 10**9 + stamp["nsec"] == time_ns and content["frame_id"] == "field"
    for name, messages, keys in (
        ("position_m", poses, ("pose", "position")),
        ("field_force_n", ticks, ("field", "force")),
        ("field_torque_nm", ticks, ("field", "torque")),
        ("friction_n", ticks, ("friction",)),
        ("force_n", ticks, ("device", "force")),
        ("torque_nm", ticks, ("device", "torque")),
        ("velocity_m_s", ticks, ("velocity",)),
    ):
        np.testing.assert_allclose(vectors(messages, *keys), rows[name], rtol=1e-8, err_msg=name)
    for key in ("gripper_m", "media_s", "buttons"):
        np.testing.assert_allclose([tick[key] for _, tick in ticks], rows[key], rtol=1e-8)
    assert {tick["state"] for _, tick in ticks} == {"running+stalled"}


def test_axes_of_the_device_become_those_of_the_field(tmp_path: Path) -> None:
    rows, path = random_rows(50), tmp_path / "a.mcap"
    write_mcap(path, rows, MIRROR)
    read = messages_of(path)
    force_n = vectors(read[TICK_TOPIC], "device", "force")
    np.testing.assert_allclose(force_n, rows["force_n"][:, [1, 0, 2]], rtol=1e-8)
    # a torque is lever x force: a lever that is mirrored as the force gives the torque
    lever_m = np.random.default_rng(1).normal(size=3)
    rows["torque_nm"] = np.cross(lever_m, rows["force_n"])
    write_mcap(path, rows, MIRROR)
    read = messages_of(path)
    expected_nm = np.cross(MIRROR @ lever_m, force_n)
    np.testing.assert_allclose(vectors(read[TICK_TOPIC], "device", "torque"), expected_nm, atol=1e-8)
    found = Rotation.from_quat(vectors(read[POSE_TOPIC], "pose", "orientation", axes="xyzw"))
    of_device = Rotation.from_quat(rows["orientation"][:, [1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(found.as_matrix(), MIRROR @ of_device @ MIRROR, atol=1e-7)


def test_arrows_have_the_force_and_a_limited_rate(tmp_path: Path) -> None:
    rows, path = random_rows(1000), tmp_path / "a.mcap"
    rows["force_n"][0], rows["force_n"][17] = (-2.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    write_mcap(path, rows, np.eye(3))
    arrows = messages_of(path)[ARROW_TOPIC]
    assert 50 <= len(arrows) <= ARROWS_HZ and arrows[1][0] == 17 * 10**6
    for time_ns, content in arrows:
        (entity,), row = content["entities"], rows[time_ns // 10**6]
        if not row["force_n"].any():
            assert entity["arrows"] == []
            continue
        (arrow,) = entity["arrows"]
        length_m = arrow["shaft_length"] + arrow["head_length"]
        x, y, z, w = (arrow["pose"]["orientation"][axis] for axis in "xyzw")
        pointing = Rotation.from_quat((x, y, z, w)).apply((length_m / ARROW_M_PER_N, 0.0, 0.0))
        np.testing.assert_allclose(pointing, row["force_n"], atol=1e-6)
        np.testing.assert_allclose([arrow["pose"]["position"][a] for a in "xyz"], row["position_m"])


def test_ticks_without_a_finite_number_are_reported(tmp_path: Path) -> None:
    rows, path = random_rows(20), tmp_path / "a.mcap"
    rows["position_m"][3, 1], rows["orientation"][5] = np.nan, np.nan
    (note,) = write_mcap(path, rows, np.eye(3))
    assert note.startswith("2 ticks are not in ") and len(messages_of(path)[TICK_TOPIC]) == 18


def test_chunks_are_small(tmp_path: Path) -> None:
    """Neither the writer nor a reader holds more than a chunk: not the hour that a log may last."""
    path = tmp_path / "a.mcap"
    write_mcap(path, random_rows(9000), np.eye(3))
    with path.open("rb") as file:
        chunks = reader.make_reader(file).get_summary().chunk_indexes
    assert len(chunks) > 3 and max(chunk.uncompressed_size for chunk in chunks) < 1.1 * 2**20


def test_a_log_is_a_recording_as_its_csv_is(
    stream: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs = tmp_path / "a.csv", tmp_path / "a.mcap"
    for log in logs:
        assert _exit_code(["play", str(stream), "--offline", "--log", str(log), "--friction", "0.3"]) == 0
    capsys.readouterr()
    table, recorded = read_contacts(logs[0]), read_mcap(logs[1])
    assert table.forces_n.any()
    np.testing.assert_allclose(recorded.positions_m, table.positions_m, atol=1e-10)
    np.testing.assert_allclose(recorded.forces_n, table.forces_n, rtol=1e-8)


def test_a_missing_library_is_reported_before_the_playback(
    stream: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    monkeypatch.setattr("touchfield.tasks.play.play", lambda *_: pytest.fail("it played"))
    assert _exit_code(["play", str(stream), "--offline", "--log", str(tmp_path / "a.MCAP")]) == 2
    error = capsys.readouterr().err
    assert "the library mcap is not installed" in error and "touchfield[mcap]" in error
    assert error.count("\n") == 1 and not [*tmp_path.iterdir()]
