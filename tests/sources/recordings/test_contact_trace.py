"""Recorded contacts as a source: a field without curl, near the contacts and nowhere else."""

from __future__ import annotations

import json
import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from touchfield.cli.main import _exit_code
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument, MissingExtra, SourceError
from touchfield.medium import Grid
from touchfield.medium.trace import ContactTrace, read_contacts, read_trace
from touchfield.pipeline import encode, prepare
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.laws import LawSpec, profile_of
from touchfield.sources.options import SourceOptions
from touchfield.sources.recordings.contact_trace import (
    ContactScene,
    CurlFree,
    recorded_contacts,
    sampling_loss,
    thin_contacts,
)
from touchfield.sources.registry import open_source

PROFILE = profile_of(LawSpec(), 3.3)


def spring(points: np.ndarray) -> np.ndarray:
    """A gradient: 200 N/m towards the origin along x and y, 400 along z."""
    return -points * [200.0, 200.0, 400.0]


def probed(count: int = 4000, twist_n_per_m: float = 0.0) -> ContactTrace:
    points = np.random.default_rng(1).uniform(-0.02, 0.02, (count, 3))
    curl = twist_n_per_m * np.cross([0, 0, 1], points)
    return ContactTrace(points, spring(points) + curl)


@pytest.fixture(scope="module")
def plain() -> ContactScene:
    """A scene of a gradient alone."""
    return ContactScene(probed())


def written(path: Path, trace: ContactTrace, header: str = "x_m,y_m,z_m,fx_n,fy_n,fz_n") -> Path:
    rows = np.hstack([trace.positions_m, trace.forces_n])
    np.savetxt(path, rows, delimiter=",", header=header, comments="")
    return path


def test_a_gradient_comes_back(plain: ContactScene) -> None:
    at = np.random.default_rng(2).uniform(-0.015, 0.015, (300, 3))
    found = plain.interpolant.forces_n(at)
    assert np.abs(found - spring(at)).max() < 0.03 * np.abs(spring(at)).max()
    assert plain.interpolant.relative_error < 0.1 and "%" in plain.notes[0]


@pytest.mark.parametrize("noise", [1e-4, 0.1])
def test_a_fit_reproduces_its_forces_and_estimates_the_error_of_others(noise: float) -> None:
    rng = np.random.default_rng(5)
    points, forces = rng.uniform(0, 0.02, (12, 3)), rng.normal(0, 2, (12, 3))
    fit = CurlFree.through(points, forces, 0.01, noise)
    assert fit.forces_n(points) + noise * fit.weights == pytest.approx(forces, abs=1e-8)
    residuals = []
    for n in range(12):
        others = np.arange(12) != n
        rest = CurlFree.through(points[others], forces[others], 0.01, noise)
        residuals.append(forces[n] - rest.forces_n(points[n : n + 1])[0])
    assert fit.relative_error == pytest.approx(np.sqrt(np.mean(np.square(residuals)) / np.mean(forces**2)))


def test_the_field_has_no_curl_for_any_recording(plain: ContactScene) -> None:
    turning = ContactScene(probed(twist_n_per_m=300.0))
    at, step = np.random.default_rng(3).uniform(-0.01, 0.01, (50, 3)), 1e-6
    gradient = np.stack(
        [
            (turning.interpolant.forces_n(at + step * axis) - turning.interpolant.forces_n(at - step * axis))
            / (2 * step)
            for axis in np.eye(3)
        ],
        axis=1,
    )  # [n, derivative along, component]
    assert np.abs(gradient - gradient.transpose(0, 2, 1)).max() < 1e-3 * np.abs(gradient).max()
    assert (
        turning.interpolant.relative_error > 3 * plain.interpolant.relative_error
    )  # and the residual is reported


def test_no_force_away_from_the_contacts(plain: ContactScene) -> None:
    grid = Grid((40, 40, 40), (0.005,) * 3, (-0.1,) * 3)
    field = plain.field(0, grid, PROFILE)
    dense = field.to_dense()
    points = grid.to_m(np.stack(np.meshgrid(*[np.arange(40)] * 3, indexing="ij"), axis=-1))
    is_distant = np.linalg.norm(np.maximum(np.abs(points) - 0.02, 0), axis=-1) > plain.reach_m
    assert dense.any() and not dense[is_distant].any()
    inside = np.abs(points).max(axis=-1) < 0.015
    assert dense[inside] == pytest.approx(spring(points[inside]), abs=0.2)


def test_a_csv_becomes_a_stream(tmp_path: Path) -> None:
    path = written(tmp_path / "probe.csv", probed(120))
    spec = EncodeSpec(nw=5, mapping="1", touch=TouchSpec(k=0.02, f0_n=0.0, effort="fast"))
    done = encode(path, tmp_path / "probe.touch", spec)
    assert any("leave-one-out error of" in note for note in done.notes)
    with open_file(tmp_path / "probe.touch") as opened:
        frame = opened.medium[0]
        support = frame.support()
        out = frame.grid.to_m(support.positions) - frame.grid.to_m(support.positions).mean(axis=0)
        assert len(opened.medium) == 1 and len(out) > 100
        assert (np.einsum("ij,ij->i", out, frame.vectors_n()) < 0).mean() > 0.95  # a spring pulls back


def tapped(count: int = 2000) -> ContactTrace:
    """A probe that taps on a floor of 500 N/m, y up, while it moves along x and z."""
    seconds = np.arange(count) * (4.0 / count)
    x, z = (s * np.sin(2 * np.pi * hertz * seconds) for s, hertz in ((0.02, 0.7), (0.015, 0.43)))
    y = 0.002 - 0.004 * (0.5 + 0.5 * np.sin(2 * np.pi * 2.1 * seconds))
    forces = np.zeros((count, 3))
    forces[:, 1] = 500 * np.maximum(0, -y)
    return ContactTrace(np.stack([x, y, z], axis=1), forces)


def trilinear(dense: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Interpolate [x, y, z, 3] at fractional indices [n, 3], as a receiver does."""
    low = np.floor(index).astype(int)
    total = np.zeros((len(index), 3))
    for corner in np.ndindex(2, 2, 2):
        weights = np.where(corner, index - low, 1 - (index - low)).prod(axis=1)
        total += weights[:, None] * dense[tuple((low + corner).T)]
    return total


@pytest.mark.parametrize(("nw", "most"), [(5, 0.35), (6, 0.12)])
def test_the_note_states_what_the_file_misses_at_the_recorded_positions(
    tmp_path: Path, nw: int, most: float
) -> None:
    trace = tapped()
    done = encode(written(tmp_path / "a.csv", trace), tmp_path / "a.touch", EncodeSpec(nw=nw, mapping="1"))
    with open_file(tmp_path / "a.touch") as opened:
        frame, offset_m = opened.medium[0], np.array(opened.summary()["mapping_offset_m"])
    found = trilinear(frame.to_dense(), frame.grid.to_index(trace.positions_m - offset_m))
    missed = np.sqrt(((found - trace.forces_n) ** 2).sum() / (trace.forces_n**2).sum())
    (note,) = [note for note in done.notes if "the file misses" in note]
    assert f"misses {100 * missed:.3g} % of the forces" in note and "2000 recorded positions" in note
    assert missed < most  # 0.57 at nw 6 while the kernel was narrower than a sample


def test_the_kernel_is_three_samples_of_the_lattice_or_longer() -> None:
    scene = ContactScene(tapped())
    box_m = scene.bounds_m()
    lengths_m = []
    for spacing_m in (0.0001, 0.003, 0.0002):
        scene.set_lattice(Grid((4, 4, 4), (spacing_m, 0.0001, 0.0001), (0, 0, 0)), 3.3)
        lengths_m.append(scene.interpolant.length_m)
        assert lengths_m[-1] >= 3 * spacing_m and f"beyond {1e3 * scene.reach_m:.3g} mm" in scene.notes[0]
    assert lengths_m[1] >= 0.009 > lengths_m[0], "a later lattice has a fit of its own"
    assert scene.bounds_m() == pytest.approx(box_m)


def test_a_fit_that_exceeds_the_device_beside_the_path_is_not_used() -> None:
    """Two passes 1.6 mm apart with opposite friction: an exact fit is far above 2 N beside them."""
    x = np.linspace(-0.02, 0.02, 300)
    points = np.concatenate(
        [np.stack([x, 0 * x + y, 0.0003 * np.sin(300 * x)], axis=1) for y in (-8e-4, 8e-4)]
    )
    forces = np.concatenate(
        [np.stack([0 * x + f, 0 * x, 1 + 0.3 * np.sin(400 * x)], axis=1) for f in (0.8, -0.8)]
    )
    grid = Grid((64, 16, 16), (0.001, 0.001, 0.001), (-0.0315, -0.0075, -0.0075))
    scene = ContactScene(ContactTrace(points, forces))
    scene.set_lattice(grid, 2.0)
    averages = thin_contacts(points, forces)
    by_error = CurlFree.fitted(*averages, 0.003)

    def missed(fit: CurlFree) -> float:
        """Sampled everywhere, clipped to 2 N and interpolated, against the recording."""
        dense = fit.forces_n(grid.to_m(np.argwhere(np.ones(grid.shape))), fit.length_m).reshape(
            *grid.shape, 3
        )
        size = np.linalg.norm(dense, axis=-1, keepdims=True)
        found = trilinear(dense * np.minimum(1, 2.0 / np.maximum(size, 1e-9)), grid.to_index(points))
        return float(np.sqrt(((found - forces) ** 2).sum() / (forces**2).sum()))

    assert scene.interpolant.relative_error > by_error.relative_error
    assert missed(scene.interpolant) < 0.7 * missed(by_error)
    assert sampling_loss(by_error, averages[0], grid, 2.0) > 0.5
    assert sampling_loss(by_error, averages[0], grid.refined(8), 1e6) < 0.1, "fine, and without a limit"


def test_recorded_positions_outside_the_workspace_are_noted(tmp_path: Path) -> None:
    trace = tapped()
    far = ContactTrace(trace.positions_m * [30, 1, 1], trace.forces_n)  # 1.2 m, more than the device reaches
    done = encode(written(tmp_path / "a.csv", far), tmp_path / "a.touch", EncodeSpec(nw=5, mapping="1"))
    assert any("% of the recorded positions are outside the workspace" in note for note in done.notes)
    everything = encode(
        written(tmp_path / "b.csv", trace), tmp_path / "b.touch", EncodeSpec(nw=5, mapping="1")
    )
    assert not any("outside the workspace" in note for note in everything.notes)


def test_logs_of_a_play_and_units_are_read(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(
        "t_s,x_m,y_m,z_m,field_x_n,field_y_n,field_z_n,force_x_n,force_y_n,force_z_n,state\n"
        "0,1,2,3,4,5,6,7,8,9,idle\n"
    )
    trace = read_contacts(tmp_path / "log.csv")
    assert trace.forces_n.tolist() == [[4, 5, 6]] and trace.positions_m.tolist() == [[1, 2, 3]]
    (tmp_path / "mm.csv").write_text("x [mm];y [mm];z [mm];Fx (mN);Fy (mN);Fz (N)\n1;2;3;4;5;6\n")
    trace = read_contacts(tmp_path / "mm.csv")
    assert trace.forces_n[0] == pytest.approx([0.004, 0.005, 6]) and trace.positions_m[0, 0] == 0.001
    assert len(read_trace(tmp_path / "log.csv")) == 1  # also as a trajectory to play


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x_m,y_m,z_m,fx_n,fy_n\n1,2,3,4,5\n", "no column for fz"),
        ("x_m,y_m,z_m,fx_kn,fy_n,fz_n\n1,2,3,4,5,6\n", "no column for fx"),
        ("x_m,y_m,z_m,fx,fy_n,fz_n\n1,2,3,4,5,6\n", "fx_ and one of n, mn"),
        ("x_m,y_m,z_m,fx_n,fy_n,fz_n\n1,2,3,4,5,six\n", "line 2, column fz"),
        ("x_m,y_m,z_m,fx_n,fy_n,fz_n\n1,2,3,4,5,6\n1,2,3,4,5,6\n", "never moved"),
        ("x_m,y_m,z_m,fx_n,fy_n,fz_n\n1,2,3,0,0,0\n2,2,3,0,0,0\n", "no force"),
        ("x_m,y_m,z_m,fx_n,fy_n,fz_n\n1,2,3,1,0,0\n2,2,3,1,0,0\n", "2 places"),
        ("x_m,y_m,z_m,fx_n,fy_n,fz_n\n1,2,3,1e6,0,0\n2,2,3,1,0,0\n", "Check the units"),
    ],
)
def test_errors_of_invalid_traces_name_the_fault(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(SourceError) as caught:
        open_source(tmp_path / "a.csv", SourceOptions(kind="contacts"))
    assert message in str(caught.value) and "a.csv" in str(caught.value)


def test_notes_of_a_recording(plain: ContactScene, tmp_path: Path) -> None:
    points = plain.interpolant.points_m
    assert plain.bounds_m() == pytest.approx(
        np.stack([points.min(axis=0) - plain.reach_m, points.max(axis=0) + plain.reach_m])
    )
    assert len(plain.notes) == 1
    twisted = ContactScene(probed(40, 20_000.0))
    assert "rough mean" in twisted.notes[1]
    four = probed(4)  # the minimum
    assert ContactScene(four).interpolant.points_m.shape == (4, 3)
    with pytest.raises(InvalidArgument, match="a trace has no camera"):
        open_source(written(tmp_path / "a.csv", four), SourceOptions(frame="camera"))


@pytest.mark.parametrize(("factor", "is_noted"), [(1.0, False), (1000.0, True)])
def test_a_recording_in_millimetres_is_noted(factor: float, is_noted: bool) -> None:
    trace = probed(40)
    notes = prepare(
        ContactScene(ContactTrace(factor * trace.positions_m, trace.forces_n)), EncodeSpec(nw=4)
    ).notes
    assert any("Is the unit right?" in note and "positions are metres" in note for note in notes) == is_noted


# -- MCAP --------------------------------------------------------------------------------------------------


def mcap_file(path: Path, messages: list[tuple[str, str, str, float, bytes]]) -> Path:
    writer = pytest.importorskip("mcap.writer").Writer
    with path.open("wb") as file:
        mcap_writer = writer(file)
        mcap_writer.start()
        channels: dict[str, int] = {}
        for topic, schema, encoding, time_s, data in messages:
            if topic not in channels:
                schema_id = mcap_writer.register_schema(
                    schema, "ros2msg" if encoding == "cdr" else "jsonschema", b"{}"
                )
                channels[topic] = mcap_writer.register_channel(topic, encoding, schema_id)
            mcap_writer.add_message(channels[topic], int(time_s * 1e9), data, int(time_s * 1e9))
        mcap_writer.finish()
    return path


def stamped(*doubles: float, order: str = "<", names: tuple[bytes, ...] = (b"base\0",)) -> bytes:
    body = struct.pack(order + "iI", 0, 0)
    for name in names:
        body += b"\0" * (-len(body) % 4) + struct.pack(order + "I", len(name)) + name
    body += b"\0" * (-len(body) % 8) + struct.pack(f"{order}{len(doubles)}d", *doubles)
    return (b"\0\1\0\0" if order == "<" else bytes(4)) + body


def test_mcap_of_json_and_of_ros(tmp_path: Path) -> None:
    trace = probed(60)
    ros: list[tuple[str, str, str, float, bytes]] = []
    plain = []
    for n, (position, force) in enumerate(zip(trace.positions_m.tolist(), trace.forces_n.tolist())):
        ros += [
            ("/pose", "geometry_msgs/msg/PoseStamped", "cdr", n / 100, stamped(*position, 0, 0, 0, 1)),
            ("/wrench", "geometry_msgs/msg/WrenchStamped", "cdr", n / 100, stamped(*force, 0, 0, 0)),
            ("/sound", "audio", "raw", n / 100, b"?"),
        ]
        message: dict[str, Any] = {
            "pose": {"position": dict(zip("xyz", position))},
            "wrench": {"force": dict(zip("xyz", force))},
        }
        plain.append(("/probe", "Probe", "json", n / 100, json.dumps(message).encode()))
    other = [  # from a machine of the other byte order; a transform has the names of two frames
        (
            "/tf",
            "geometry_msgs/msg/TransformStamped",
            "cdr",
            n / 100,
            stamped(*position, order=">", names=(b"a\0", b"fingertip\0")),
        )
        for n, position in enumerate(trace.positions_m.tolist())
    ]
    other += [
        ("/wrench", "geometry_msgs/msg/WrenchStamped", "cdr", n / 100, stamped(*force, 0, 0, 0, order=">"))
        for n, force in enumerate(trace.forces_n.tolist())
    ]
    for name, messages in (("ros.mcap", ros), ("json.mcap", plain), ("other.mcap", other)):
        scene = open_source(mcap_file(tmp_path / name, messages))
        assert isinstance(scene, ContactScene)
        at = trace.positions_m[:20]
        assert scene.interpolant.forces_n(at) == pytest.approx(spring(at), abs=0.4)
    with pytest.raises(SourceError, match="no forces in /pose"):
        open_source(mcap_file(tmp_path / "a.mcap", [m for m in ros if m[0] == "/pose"]))
    (tmp_path / "b.mcap").write_bytes((tmp_path / "ros.mcap").read_bytes()[:100])
    with pytest.raises(SourceError, match=r"b\.mcap"):
        open_source(tmp_path / "b.mcap")
    with pytest.raises(SourceError, match=r"c\.mcap"):
        open_source(mcap_file(tmp_path / "c.mcap", [(*ros[0][:4], ros[0][4][:8])]))
    with pytest.raises(
        SourceError, match="found a message of 40 bytes; expected a PoseStamped of at least 52"
    ):
        open_source(mcap_file(tmp_path / "c.mcap", [(*ros[0][:4], ros[0][4][:40])]))


def test_the_position_of_a_force_in_mcap_is_that_of_its_time(tmp_path: Path) -> None:
    def message(topic: str, field: str, time_s: float, *values: float) -> tuple[str, str, str, float, bytes]:
        return topic, "Probe", "json", time_s, json.dumps({field: dict(zip("xyz", values))}).encode()

    position_messages = [
        message("/p", "position", 2, 4, 0, -2),
        message("/p", "position", 0, 0, 0, 2),
    ]  # not in order
    force = [
        message("/f", "force", time_s, time_s, 5, 6) for time_s in (1.5, 0.5, 9)
    ]  # the last one is after the positions
    others = [message("/q", "position", 3, 7, 7, 7), message("/g", "force", 3, 8, 8, 8)]
    trace = recorded_contacts(mcap_file(tmp_path / "a.mcap", [*position_messages, *force, *others]))
    assert trace is not None
    assert trace.positions_m.tolist() == [[1, 0, 1], [3, 0, -1]] and trace.forces_n.tolist() == [
        [0.5, 5, 6],
        [1.5, 5, 6],
    ]
    for messages, expected in (
        ([*position_messages, force[2]], "forces at other times than positions"),
        ([*position_messages, message("/f", "force", 1, math.nan, 0, 0)], "not finite"),
    ):
        with pytest.raises(SourceError, match=expected):
            recorded_contacts(mcap_file(tmp_path / "b.mcap", messages))


def test_without_the_library_mcap_names_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "mcap.reader", None)
    (tmp_path / "a.mcap").write_bytes(b"")
    with pytest.raises(MissingExtra, match="mcap"):
        open_source(tmp_path / "a.mcap")


@pytest.mark.shared
def test_a_real_recording(tmp_path: Path, shared_data: Path) -> None:
    from scipy.io import loadmat

    path = shared_data / "force_panda_comanipulation" / "symbol_data.mat"
    symbol = loadmat(path, squeeze_me=True, struct_as_record=False)["symbol_data"][0]
    trace = ContactTrace(symbol.pos.T.astype(float), symbol.F.T.astype(float))
    scene = open_source(written(tmp_path / "panda.csv", trace))
    assert isinstance(scene, ContactScene) and scene.interpolant.relative_error < 0.25
    sampled_m = trace.positions_m[::7]
    residual_n = scene.interpolant.forces_n(sampled_m) - trace.forces_n[::7]
    assert np.sqrt((residual_n**2).mean() / (trace.forces_n**2).mean()) < 0.3


# -- played again ------------------------------------------------------------------------------------------


def test_a_recording_is_reproduced_along_its_path(tmp_path: Path) -> None:
    angle = np.linspace(0, 6 * np.pi, 3000)
    points = 0.2 + np.stack([0.015 * np.cos(angle), 0.015 * np.sin(angle), 0.01 * np.sin(angle / 3)], axis=1)
    pulled = ContactTrace(points, (points - 0.2) * -100)
    path = written(tmp_path / "probe.csv", pulled)
    encode(path, tmp_path / "a.touch", EncodeSpec(nw=6, touch=TouchSpec(k=0.02, f0_n=0.0, effort="fast")))
    log = tmp_path / "log.csv"
    arguments = ["play", str(tmp_path / "a.touch"), "--offline", "--trace", str(path), "--seconds", "2.9"]
    assert _exit_code([*arguments, "--log", str(log)]) == 0
    played_n = read_contacts(log).forces_n[100:]
    expected_n = pulled.forces_n[100 : 100 + len(played_n)]
    assert np.sqrt(((played_n - expected_n) ** 2).mean()) < 0.15 * np.sqrt((expected_n**2).mean())
    assert _exit_code([*arguments, "--trajectory", str(path)]) == 2  # only one of them
    assert _exit_code([*arguments[:4], str(tmp_path / "none.csv")]) == 1
