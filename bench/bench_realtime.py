"""Measures whether real rooms are encoded, decoded and sent live in real time at the resolution of a device.

    python bench/bench_realtime.py [--quick] [--nw N] [--loops N] [--seconds S]

The inputs are TUM fr1_rpy (a moving Kinect) and the ICL living room, as far as the optional folder of inputs
has them, as walls, fused ("fused") and with each frame on its own ("frames"). A sequence has 24 frames, and
is repeated.

* files: `encode_frames_s` counts frames that are made, coded, checked and written by all cores, after the
  world is built; `world_s` is the time of that. `decode_frames_s` reads the same file in order. `..._cores`
  are processor seconds over seconds. Processor milliseconds per frame, each in one thread: `source_ms` makes
  the field on the fine lattice, `filter_ms` filters and limits it, `code_ms` codes it and compares each voxel
  with the bound, `check_ms` decodes the result and compares again (effort "default" less "fast": about 0 for
  segments with outliers, which both decode), `decode_ms` decodes it.
* live: a simulated camera shows pictures at 30 Hz, and `live` sends them at n_w 7. "moving" are the frames of
  TUM, each on its own; "static" is the first of them with the noise of a Kinect, which is simulated, in a
  causal world. `coded` frames are made and coded; `left_out` are those in whose place the frame before is
  repeated, or nothing is sent. `delay_s` is the time from the arrival of the first picture of a segment to
  the moment when the segment is sent, less the length of the segment. `frame_ms` is the processor time of
  the whole process per coded frame, and `cores` that per second. One core is free if `cores` is at most 1,
  which takes 33 ms a frame if none is left out. `stages` are those of `files`, of this medium and without a
  load: planes, fusion and forces are `source_ms`; `live` checks the bound by the encoder's reconstruction,
  within `code_ms`.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench_fusion import FOLDERS, TUM, requested_lattice, spec_of
from machine import Bar, Figures, at_least, at_most, bench, leave_out
from touchfield.codec.registry import field_encoder
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.medium import ForceField
from touchfield.network.live import LiveSegment
from touchfield.pipeline import prepare
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.encoding import encode_prepared
from touchfield.pipeline.preparation import Prepared
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.depth.capture import CapturedSequence, Pictures
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.depth.fused_scene import FusedScene
from touchfield.sources.images.pictures import read_picture
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source
from touchfield.sources.scene import Scene
from touchfield.tasks.live import LiveSpec, broadcast, open_sender

LIVE_NW, LIVE_HZ, SEGMENT_S = 7, 30.0, 0.25
CAMERA_SCALE = 5000.0
CAMERA = SourceOptions(intrinsics="517.3,516.5,318.6,255.3", depth_scale=CAMERA_SCALE, rate_hz=LIVE_HZ)
QUANTUM_PER_M = 2.85e-3
"""Step of inverse depth: one step of a Kinect's disparity."""
CODED = 8
"""Frames of a segment whose stages are measured."""


def processor_ms(call: Callable[[], Any]) -> float:
    """Return the processor time of a call, milliseconds, of all threads."""
    start = time.process_time()
    call()
    return 1e3 * (time.process_time() - start)


def frames_per_s(call: Callable[[], Any], count: int) -> tuple[float, float]:
    """Return the frames per second of a call that handles `count` frames, and the cores that it uses."""
    start, start_cpu = time.perf_counter(), time.process_time()
    call()
    seconds = time.perf_counter() - start
    return count / seconds, (time.process_time() - start_cpu) / seconds


def stages(prepared: Prepared, scene: Scene, spec: EncodeSpec) -> Figures:
    """Return the processor milliseconds per frame of each stage; `scene` is as that of `prepared`."""
    medium = prepared.medium
    fine, law = requested_lattice(scene, spec)  # type: ignore[arg-type]

    def make_sources(indices: range) -> None:
        for i in indices:  # none is kept: memory for all of them would take longer than the forces
            scene.field_update(i, fine, law) or scene.field(i, fine, law)

    make_sources(range(CODED))  # the first calls of compiled loops take longer
    fields, later = [medium[i] for i in range(CODED)], range(CODED, 2 * CODED)
    source_ms = processor_ms(lambda: make_sources(later)) / CODED
    make_ms = processor_ms(lambda: deque((medium[i] for i in later), maxlen=1)) / CODED
    row: Figures = {"source_ms": source_ms, "filter_ms": max(0.0, make_ms - source_ms)}
    body = b""
    for effort in ("fast", "default"):
        encoder = field_encoder(medium.grid, replace(prepared.coding, effort=effort))

        def code(encoder: Any = encoder, fields: list[ForceField] = fields) -> None:
            nonlocal body
            body = encoder.encode_segment(fields, encoder.key_frame(fields[0], None)).body

        row[f"{effort}_ms"] = processor_ms(code) / CODED
    row |= {"code_ms": row.pop("fast_ms"), "check_ms": row.pop("default_ms")}
    row["check_ms"] -= row["code_ms"]
    decoder = TouchDecoder(medium.grid, field_encoder(medium.grid, prepared.coding).parameters)
    row["decode_ms"] = processor_ms(lambda: list(decoder.frames(body, CODED))) / CODED
    return row


def file_row(name: str, world: str, nw: int, loops: int) -> Figures:
    """Return the speed of encoding and decoding a sequence, repeated `loops` times, and its stages."""
    spec = spec_of(world, nw=nw)
    prepared = prepare(str(FOLDERS[name]), spec)
    medium = prepared.medium
    world_s = processor_ms(lambda: medium[0]) / 1e3
    field, count = medium[0], loops * len(medium)
    looped = replace(medium, frame_count=count, make_frame=lambda i: medium[i % len(medium)])
    row: Figures = {"sequence": name, "world": world, "voxels": field.support_count, "world_s": world_s}
    with tempfile.TemporaryDirectory() as folder:
        path, encoded = Path(folder) / "it.touch", list[Any]()
        rate, cores = frames_per_s(
            lambda: encoded.append(encode_prepared(replace(prepared, medium=looped), path, {})), count
        )
        row |= {"encode_frames_s": rate, "encode_cores": cores, "bytes": encoded[0].file_bytes}
        with open_file(path) as opened:
            decoded = opened.medium
            rate, cores = frames_per_s(lambda: [decoded[i] for i in range(count)], count)
    row |= {"decode_frames_s": rate, "decode_cores": cores}
    return row | stages(prepared, open_source(str(FOLDERS[name]), spec.source), spec)


def static_pictures(picture: NDArray[Any]) -> list[NDArray[Any]]:
    """Return a picture with the noise of a Kinect: half a step of disparity, and its quantisation."""
    rng, z_m = np.random.default_rng(1), picture / CAMERA_SCALE
    steps = np.divide(1.0, z_m * QUANTUM_PER_M, out=np.zeros(z_m.shape), where=z_m > 0)
    found = []
    for _ in range(24):
        noisy = np.round(np.where(steps > 0, np.maximum(steps + rng.normal(0, 0.5, steps.shape), 1.0), 0.0))
        metres = np.divide(1.0, noisy * QUANTUM_PER_M, out=np.zeros(z_m.shape), where=noisy > 0)
        found.append(np.clip(np.rint(metres * CAMERA_SCALE), 0, 65535).astype(np.uint16))
    return found


class SimulatedCamera(Pictures):
    """Pictures that are shown in a loop; `latest_s` is when the latest one arrived.

    They are shown at `LIVE_HZ`, or, if `in_order`, as fast as they are requested.
    """

    def __init__(self, pictures: list[NDArray[Any]], in_order: bool = False) -> None:
        self.name, self.in_order = "a simulated camera", in_order
        self._pictures = pictures
        self._count, self._start_s, self.latest_s = 0, time.monotonic(), 0.0

    def next(self) -> Any:
        if not self.in_order:
            time.sleep(max(0.0, self._start_s + self._count / LIVE_HZ - time.monotonic()))
        picture = self._pictures[self._count % len(self._pictures)]
        self._count, self.latest_s = self._count + 1, time.monotonic()
        return picture


class TimedSequence(CapturedSequence):
    """Captured pictures; `arrivals_s` has the time at which the picture of each frame arrived."""

    def __init__(self, camera: SimulatedCamera) -> None:
        self.camera, self.arrivals_s = camera, dict[int, float]()
        super().__init__(camera, CAMERA)

    def depth_m(self, frame: int) -> Any:
        self.arrivals_s.setdefault(frame, self.camera.latest_s)
        return super().depth_m(frame)


def live_scene(sequence: CapturedSequence, name: str) -> DepthScene:
    """Return captured pictures as `live` opens them."""
    return FusedScene(sequence, "causal") if name == "static" else DepthScene(sequence, frame="camera")


def live_stages(name: str, pictures: list[NDArray[Any]]) -> Figures:
    """Return the stages of the medium that is sent live, of pictures that are all there."""
    spec = EncodeSpec(nw=LIVE_NW, source=CAMERA)
    sequences = [CapturedSequence(SimulatedCamera(pictures, in_order=True), CAMERA) for _ in range(2)]
    scene, other = (live_scene(sequence, name) for sequence in sequences)
    row = stages(open_sender(scene, spec)[0], other, spec)
    for sequence in sequences:
        sequence.close()
    return row


def live(name: str, pictures: list[NDArray[Any]], seconds: float) -> Figures:
    """Send pictures live for some seconds; return processor time, delays, and what was left out."""
    sequence = TimedSequence(SimulatedCamera(pictures))
    scene = live_scene(sequence, name)
    prepared, sender = open_sender(scene, EncodeSpec(nw=LIVE_NW, source=CAMERA))
    delays_s, start = list[float](), [0.0, 0.0]

    def send(segment: LiveSegment) -> bytes | None:
        message = sender.add(segment)
        length_s = segment.frame_count / LIVE_HZ
        if segment.first_frame in sequence.arrivals_s:  # frame 0 was made before the stream began
            delays_s.append(time.monotonic() - sequence.arrivals_s[segment.first_frame] - length_s)
        return message

    def on_start() -> None:
        sequence.arrivals_s.clear()
        start[:] = time.process_time(), time.monotonic()

    sent = broadcast(prepared, send, LiveSpec(SEGMENT_S, seconds=seconds), on_start=on_start)
    cpu_s, elapsed_s = time.process_time() - start[0], time.monotonic() - start[1]
    sequence.close()
    return {
        "camera": name,
        "coded": sent.frames,
        "left_out": sent.left_out,
        "coded_hz": sent.frames / elapsed_s,
        "segment_s": SEGMENT_S,
        "frame_ms": 1e3 * cpu_s / max(1, sent.frames),
        "cores": cpu_s / elapsed_s,
        "delay_s": float(np.median(delays_s)) if delays_s else None,
        "longest_delay_s": max(delays_s, default=None),
        "sent_kb_per_s": sent.sent_bytes / elapsed_s / 1e3,
        "worst_error": sent.worst_mask_ratio,
        "stages": live_stages(name, pictures),
    }


def measure(nw: int, loops: int, seconds: float) -> Figures:
    """Measure the available sequences."""
    present = [name for name, folder in FOLDERS.items() if folder.is_dir()]
    if not present:
        leave_out("the folder of inputs is missing")
    rows = [file_row(name, world, nw, loops) for name in present for world in ("fused", "frames")]
    figures: Figures = {"nw": nw, "load": os.getloadavg()[0], "files": rows}
    if TUM in present:
        moving = [read_picture(path) for path in sorted((FOLDERS[TUM] / "depth").glob("*.png"))]
        cameras = {"moving": moving, "static": static_pictures(moving[0])}
        figures["live"] = [live(name, pictures, seconds) for name, pictures in cameras.items()]
    return figures


def bars(figures: Figures) -> list[Bar]:
    """Require 8 encoded and 25 decoded frames/s of fused walls, and a live stream with one core free."""
    found: list[Bar] = []
    for row in figures["files"]:
        if row["world"] == "fused":
            title = f"{row['sequence']}, fused"
            found.append(at_least(f"{title}: encoding", row["encode_frames_s"], 8.0, "frames/s"))
            found.append(at_least(f"{title}: decoding", row["decode_frames_s"], 25.0, "frames/s"))
    for sent in figures.get("live", []):
        title = f"live, {sent['camera']} camera"
        found.append(at_most(f"{title}: processor time of a frame", sent["frame_ms"], 1e3 / LIVE_HZ, "ms"))
        found.append(at_most(f"{title}: cores", sent["cores"], 1.0))
        found.append(at_most(f"{title}: longest delay beyond a segment", sent["longest_delay_s"], 0.1, "s"))
        found.append(at_most(f"{title}: frames left out", sent["left_out"], 0))
    return found


if __name__ == "__main__":
    bench(
        "realtime", __doc__, measure, bars, without=("live/*",), nw=(8, 5), loops=(4, 1), seconds=(20.0, 3.0)
    )
