"""Rigid bodies sent live: their fields once, and the poses of a simulation that goes on."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from live_makers import MODEL
from object_makers import moving_scene
from touchfield.codec.touch.spec import TouchSpec
from touchfield.container.wire import encode_record
from touchfield.errors import CorruptFile, InvalidArgument, UnsupportedVersion
from touchfield.medium import HapticObject, PoseTrack
from touchfield.network import live_scene
from touchfield.network.live import LiveReceiver, LiveSegment, LiveSender, Lost, Opened, Refused, file_of
from touchfield.network.live_medium import LiveStream
from touchfield.network.live_scene import LivePoses, live_frames
from touchfield.pipeline import encode
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.encoding import record_of
from touchfield.pipeline.preparation import Prepared
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.sampler import FieldSampler
from touchfield.sources.options import SourceOptions
from touchfield.tasks.live import LiveSpec, PreparedBodies, Sent, broadcast, coarse_layer, open_sender
from touchfield.tasks.live_bodies import BodiesEncoder

pytest.importorskip("mujoco", reason="simulated bodies need the extra physics")

RATE_HZ, SEGMENT_S, SECONDS = 1000.0, 0.1, 0.5
SPEC = EncodeSpec(nw=4, representation="object", source=SourceOptions(seconds=SECONDS))


class Broadcast(NamedTuple):
    """What was sent of a model, and the file of the same seconds."""

    prepared: Prepared
    sender: LiveSender
    messages: list[bytes]
    sent: Sent
    file: Path


def on_air(model: Path, control: Any = None) -> tuple[Prepared, LiveSender, list[bytes], Sent]:
    """Broadcast a model in simulated time, which waits for the encoder."""
    prepared, sender = open_sender(str(model), SPEC, control=control)
    now_s, messages = 0.0, list[bytes]()

    def pause(seconds: float) -> None:
        nonlocal now_s
        deadline_s = time.monotonic() + 60
        while len(messages) < int(now_s / SEGMENT_S + 1e-6) and time.monotonic() < deadline_s:
            time.sleep(0.001)
        now_s += seconds

    def send(segment: LiveSegment) -> None:
        messages.append(sender.add(segment))

    spec = LiveSpec(SEGMENT_S, seconds=SECONDS)
    sent = broadcast(prepared, send, spec, clock_s=lambda: now_s, pause=pause)
    return prepared, sender, messages, sent


@pytest.fixture(scope="module")
def aired(tmp_path_factory: pytest.TempPathFactory) -> Broadcast:
    folder = tmp_path_factory.mktemp("bodies")
    (folder / "model.xml").write_text(MODEL)
    file = folder / "model.touch"
    encode(str(folder / "model.xml"), file, SPEC)
    return Broadcast(*on_air(folder / "model.xml"), file)


def received(aired: Broadcast, numbers: range | tuple[int, ...]) -> LivePoses:
    """The frames of a receiver that gets these segments."""
    receiver = LiveReceiver()
    (opened,) = receiver.receive(aired.sender.opening)
    assert isinstance(opened, Opened)
    frames = live_frames(opened)
    for number in numbers:
        for event in receiver.receive(aired.messages[number]):
            assert isinstance(event, LiveSegment | Lost), event
            frames.take(event)
    assert isinstance(frames, LivePoses)
    return frames


def test_forces_are_those_of_the_file_within_the_bound(aired: Broadcast) -> None:
    """Of the source's fields at the decoded poses: |error| <= max(F_0, k |F|), at any point. A file keeps
    that bound at the samples of its lattice.
    """
    source, spec = aired.prepared.objects, aired.prepared.spec
    assert source is not None
    frames, rng = received(aired, range(1, 5)), np.random.default_rng(3)
    with open_file(aired.file) as stream:
        stored = stream.scene
        assert stored is not None and stored.frame_count == 500
        samples = source.grid.to_m(np.moveaxis(np.indices(source.grid.shape), 0, -1).reshape(-1, 3))
        compared = touched = 0
        for i in range(0, 400, 23):
            number = frames.stream_frame(i)
            assert number == 100 + i
            poses = frames.poses(i)
            objects = tuple(
                HapticObject(body.name, body.medium, PoseTrack(q[None], t[None]))
                for body, q, t in zip(source.objects, poses.quaternions, poses.positions_m, strict=True)
            )
            middles = np.concatenate([body.track.to_scene(np.zeros((200, 3)), 0) for body in objects])
            points = np.concatenate([samples, middles + rng.normal(0, 0.02, middles.shape)])
            expected = replace(source, objects=objects).sample_n(0, points)
            got, of_file = frames.scene.sample_n(i, points), stored.sample_n(number, samples)
            mask = np.maximum(spec.f0_n, spec.k * np.linalg.norm(expected, axis=1))
            assert (np.linalg.norm(got - expected, axis=1) <= mask + 1e-6).all()
            # the error of both, and that of two poses within 10 um of their place on a wall of 500 N/m
            difference_n = np.linalg.norm(got[: len(samples)] - of_file, axis=1)
            assert (difference_n <= 2 * mask[: len(samples)] + 0.01).all()
            for live, file, body in zip(poses.positions_m, stored.objects, source.objects):
                assert np.linalg.norm(live - file.track.positions_m[number]) < 2e-5, body.name
            compared, touched = (
                compared + len(points),
                touched + int((np.linalg.norm(got, axis=1) > 0.1).sum()),
            )
    assert compared > 5000 and touched > 500


def test_segments_have_poses_alone_and_state_their_error(aired: Broadcast) -> None:
    sent, opening = aired.sent, len(aired.sender.opening)
    assert (sent.frames, sent.segments, sent.left_out) == (500, 5, 0)
    assert max(map(len, aired.messages)) < 1000 < opening
    assert sent.worst_mask_ratio is not None and 0 < sent.worst_mask_ratio <= 1
    bound = sent.error_bound(aired.prepared)
    assert bound["promise_kept"] and "every body within 10 um" in bound["error_bound"]


def test_a_late_receiver_has_the_bodies_with_its_first_segment(aired: Broadcast) -> None:
    sender, subscriber, messages = aired.sender, aired.sender.joined(), list[bytes]()
    while (message := sender.next(subscriber)) is not None:
        messages.append(message)
    assert messages == [sender.opening, aired.messages[-1]]
    frames = received(aired, (4,))
    assert frames.stream_frame(0) == 400 and not frames.poses(0).is_absent
    live = LiveStream("live", frames)
    assert live.scene is frames.scene and live.scene.objects[1].name == "ball"
    assert live.medium[0].support_count > 100


def test_a_segment_is_a_complete_file(aired: Broadcast, tmp_path: Path) -> None:
    (tmp_path / "segment.touch").write_bytes(file_of(aired.sender.opening, aired.messages[2]))
    frames = received(aired, (2,))
    with open_file(tmp_path / "segment.touch") as stream:
        assert stream.scene is not None and stream.error_bound()["promise_kept"]
        for i in (0, 50, 99):
            np.testing.assert_array_equal(stream.medium[i].to_dense(), frames(i).to_dense())


def test_bodies_have_no_force_in_frames_that_are_lost(aired: Broadcast) -> None:
    frames = received(aired, (1, 3))
    assert frames.lost == 100 and [frames.poses(i).is_absent for i in (99, 100, 199, 200)] == [0, 1, 1, 0]
    place = np.add(frames.poses(99).positions_m[1], (0.0, 0.0, 0.018))
    forces = [np.linalg.norm(FieldSampler(frames.scene).force_n(i / RATE_HZ, place)) for i in (99, 150, 200)]
    assert forces[0] > 0.1 and forces[1] == 0.0 and forces[2] > 0.1, forces
    assert [i for i in range(300) if frames.poses(i) and frames.is_seam(i)] == [0, 100, 200]


def test_a_control_moves_the_bodies(aired: Broadcast, tmp_path: Path) -> None:
    (tmp_path / "model.xml").write_text(MODEL)
    calls: list[float] = []

    def control(model: Any, data: Any) -> None:
        data.ctrl[0] = -0.01
        calls.append(data.time)

    prepared, sender, messages, sent = on_air(tmp_path / "model.xml", control)
    driven = received(Broadcast(prepared, sender, messages, sent, tmp_path), range(1, 5))
    free = received(aired, range(1, 5))
    turned, swung = driven.poses(399).quaternions[2], free.poses(399).quaternions[2]
    assert abs(np.dot(turned, swung)) < 0.9 and len(calls) >= 500
    np.testing.assert_allclose(driven.poses(399).positions_m[1], free.poses(399).positions_m[1], atol=1e-4)


@cache
def coded(damping: float, mode: str = "mask") -> BodiesEncoder:
    scene = moving_scene(40, deforming=False, surface_damping=damping)
    return BodiesEncoder(scene, TouchSpec(mode=mode), 0.05)


@pytest.mark.parametrize(("damping", "mode"), [(0.0, "mask"), (2.0, "mask"), (0.0, "lossless")])
def test_the_bound_holds_at_poses_that_no_one_foresaw(damping: float, mode: str) -> None:
    encoder = coded(damping, mode)
    rng = np.random.default_rng(8)
    for _ in range(5):  # both bodies overlap, in any attitude
        quaternions = rng.normal(size=(3, 2, 4))
        quaternions /= np.linalg.norm(quaternions, axis=2, keepdims=True)
        frames = [(q, rng.normal((0.0, 0.0, 0.01), 0.003, (2, 3))) for q in quaternions]
        result = encoder.encode_frames(frames)
        assert result.max_error is not None and result.max_error.ratio <= 1
        assert mode == "mask" or result.max_error.ratio == 0


def test_what_cannot_be_sent_as_bodies_is_refused(aired: Broadcast, tmp_path: Path) -> None:
    with pytest.raises(InvalidArgument, match="rigid bodies"):
        open_sender("sample:terrain", SPEC)
    with pytest.raises(InvalidArgument, match="deforms"):
        BodiesEncoder(moving_scene(), TouchSpec(), 0.05)
    with pytest.raises(InvalidArgument, match="--mode mask"):
        BodiesEncoder(moving_scene(deforming=False), TouchSpec(mode="nmse"), 0.05)
    with pytest.raises(InvalidArgument, match="--coarse"):
        coarse_layer("model.xml", aired.prepared)
    with pytest.raises(InvalidArgument, match="damping"):
        BodiesEncoder(moving_scene(deforming=False, surface_damping=1e9), TouchSpec(), 0.05)
    assert isinstance(aired.prepared, PreparedBodies) and not aired.prepared.bodies.has_end


def test_an_opening_without_its_bodies_is_refused(aired: Broadcast) -> None:
    opening = aired.sender.opening
    head_end = opening.index(b"OBJT")
    (event,) = LiveReceiver().receive(opening[:head_end])
    assert isinstance(event, Refused) and "0 OBJT" in event.reason
    receiver = LiveReceiver()
    (event,) = receiver.receive(opening[: opening.rindex(b"OBJT")])
    assert isinstance(event, Opened)
    with pytest.raises(CorruptFile, match="OBJT records"):
        live_frames(event)
    (event,) = LiveReceiver().receive(opening + aired.messages[0])
    assert isinstance(event, Refused)


def test_a_hostile_sender_takes_no_memory(aired: Broadcast, monkeypatch: pytest.MonkeyPatch) -> None:
    """A body at rest costs a few bytes for any number of frames."""
    frames = received(aired, (0,))
    monkeypatch.setattr(live_scene, "MAX_SEGMENT_POSES", 200)
    receiver = LiveReceiver()
    receiver.receive(aired.sender.opening)
    (segment,) = receiver.receive(aired.messages[1])
    frames.take(segment)
    assert frames.lost == 100 and frames(99).support_count
    monkeypatch.setattr(live_scene, "MAX_FIELD_BYTES", 1000)
    with pytest.raises(CorruptFile, match="fields take more"):
        received(aired, (0,))
    deforming = replace(record_of(coded(0.0).objects[0]), is_deforming=1, field=b"")
    (opened,) = LiveReceiver().receive(
        aired.sender.opening[: aired.sender.opening.index(b"OBJT")]
        + encode_record("OBJT", deforming) * len(frames.scene.objects)
    )
    with pytest.raises(UnsupportedVersion, match="deforms"):
        live_frames(opened)
