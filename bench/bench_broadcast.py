"""Measures live broadcast on one machine: delay, packet loss, number of receivers, and requests for ranges of
bytes.

    python bench/bench_broadcast.py [--quick] [--seconds 600] [--receivers 200] [--messages 8000] [--mib 1024]
                                    [--silent 10000]

The sender is a separate process. For the test of many receivers it sends segments that were encoded
beforehand, of 8 frames at 30 frames per second; the receivers are tasks of one other process, and each checks
every message. The delay is measured with a medium that is encoded live: it is the time of the sender's
current frame minus the time of the frame that the renderer plays.

`--seconds` is the duration of the test with `--receivers` receivers, `--silent` the number of idle
connections in a second test, `--messages` the number of messages in the simulations of packet loss, and
`--mib` the size of the file that is opened over HTTP.
"""

from __future__ import annotations

import asyncio
import multiprocessing
import socket
import statistics
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from machine import Bar, Figures, at_least, at_most, bench, figure
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.container import Head, TouchReader, TouchWriter
from touchfield.filters.resample import rebuild_level
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.network.access import Access
from touchfield.network.datagrams import Datagrams, Gathering
from touchfield.network.live import LiveReceiver, LiveSegment, LiveSender, Lost, Refused
from touchfield.network.live_server import LiveServer
from touchfield.network.udp import REPAIR
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.options import SourceOptions
from touchfield.tasks.live import LiveSpec, broadcast, open_sender

RATE_HZ, FRAMES = 30.0, 8
GRID = Grid((64, 64, 64), (0.002,) * 3, (-0.063,) * 3)


def ball(number: int) -> ForceField:
    """Return frame `number` of a ball that circles once in two seconds."""
    position_m = np.moveaxis(np.indices(GRID.shape), 0, -1) * 0.002 - 0.063
    turn = np.pi * number / RATE_HZ
    away = position_m - 0.02 * np.array([np.cos(turn), np.sin(turn), 0.0])
    distance_m = np.linalg.norm(away, axis=-1, keepdims=True)
    forces = away / np.maximum(distance_m, 1e-6) * np.clip(200 * (0.03 - distance_m), 0, 3)
    return ForceField.from_dense(GRID, forces.astype(np.float32))


def head(encoder: TouchEncoder, frames: int) -> Head:
    return Head(
        grid_shape=GRID.shape,
        spacing_m=GRID.spacing_m,
        origin_m=GRID.origin_m,
        rate_hz=RATE_HZ,
        frame_count=frames,
        axes="x right, y up, z towards the user",
        device_name="phantom-omni",
        device_type=1,
        force_max_n=3.3,
        mapping_scale=1.0,
        mapping_offset_m=(0.0, 0.0, 0.0),
        weber_fraction=0.1,
        force_threshold_n=0.05,
        friction=0.0,
        damping_n_s_per_m=0.0,
        tags=("direct",),
        coder=encoder.name,
        coder_parameters=encoder.parameters,
    )


def coded() -> tuple[TouchEncoder, list[bytes]]:
    """Return the encoder and the bodies of segments of about two seconds."""
    encoder = TouchEncoder(GRID, TouchSpec(effort="fast"))
    frames = [ball(i) for i in range(56)]
    return encoder, [encoder.encode_segment(frames[i : i + FRAMES]).body for i in range(0, 56, FRAMES)]


def sender_process(link: Connection, seconds: float) -> None:
    """Send for `seconds`; report the address first, and the resources used at the end."""
    encoder, bodies = coded()
    sender = LiveSender()
    sender.open(head(encoder, 1))
    with LiveServer(sender, Access(port=0)) as server:
        link.send(server.address)
        link.recv()
        began, cpu, memory = time.monotonic(), time.process_time(), [resident()]
        number = 0
        while time.monotonic() - began < seconds:
            server.add(LiveSegment(number * FRAMES, FRAMES, bodies[number % len(bodies)]))
            number += 1
            time.sleep(max(0.0, began + number * FRAMES / RATE_HZ - time.monotonic()))
            if number % 40 == 0:
                memory.append(resident())
        took = time.monotonic() - began
        link.send(
            {
                "segments": number,
                "cores": (time.process_time() - cpu) / took,
                "memory_mib": [memory[min(1, len(memory) - 1)], memory[-1], max(memory)],
                "receivers": server.max_receivers,
                "skipped": server.skipped,
                "left": server.dropped,
            }
        )
        server.end()
        time.sleep(2)


def resident() -> float:
    """Return the resident memory of this process, MiB."""
    line = next(
        line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmRSS")
    )
    return int(line.split()[1]) / 1024


async def receive(address: str, count: int, ready: threading.Event) -> Figures:
    """Run `count` receivers in this process; count gaps and the segments received."""
    import aiohttp

    connected, gaps, took = 0, 0, list[int]()

    async def listen(session: aiohttp.ClientSession) -> None:
        nonlocal connected, gaps
        receiver, segments = LiveReceiver(), 0
        async with session.ws_connect(f"ws://{address}/live", max_msg_size=1 << 26) as link:
            connected += 1
            if connected == count:
                ready.set()
            async for message in link:
                for event in receiver.receive(message.data):
                    gaps += isinstance(event, Lost | Refused)
                    segments += isinstance(event, LiveSegment)
        took.append(segments)

    async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0)) as session:
        await asyncio.gather(*(listen(session) for _ in range(count)))
    return {"gaps": gaps, "least_segments": min(took), "most_segments": max(took)}


def many(count: int, seconds: float, silent: int = 0) -> Figures:
    """Run a sender process, its receivers here, and `silent` idle connections."""
    parent_end, child_end = multiprocessing.get_context("spawn").Pipe()
    process = multiprocessing.get_context("spawn").Process(target=sender_process, args=(child_end, seconds))
    process.start()
    address, ready = parent_end.recv(), threading.Event()
    host, port = address.split(":")
    crowd = [socket.create_connection((host, int(port))) for _ in range(silent)]

    def start_sender() -> None:
        ready.wait()
        parent_end.send("go")

    threading.Thread(target=start_sender, daemon=True).start()
    heard = asyncio.run(receive(address, count, ready))
    sent: Figures = parent_end.recv()
    process.join()
    for link in crowd:
        link.close()
    return {**sent, **heard, "seconds": seconds, "silent": silent}


def live_process(link: Connection, segment_s: float) -> None:
    """Broadcast a medium, encoded live, until a message arrives.

    Reports the address and the start time of frame 0.
    """
    medium = HapticMedium.from_frames(
        [ball(i) for i in range(60)], RATE_HZ, "x right, y up, z towards the user"
    )
    prepared, sender = open_sender(medium, EncodeSpec())

    def clock() -> float:
        if link.poll():
            raise KeyboardInterrupt
        return time.monotonic()  # the monotonic clock is common to all processes

    with LiveServer(sender, Access(port=0)) as server, suppress(KeyboardInterrupt):
        broadcast(
            prepared,
            server.add,
            LiveSpec(segment_s, loop=True),
            clock_s=clock,
            on_start=lambda: link.send((server.address, time.monotonic())),
        )


@contextmanager
def on_air(segment_s: float) -> Iterator[tuple[str, float]]:
    """Broadcast a live medium from another process; yield its address and start time.

    The start time is that of frame 0.
    """
    parent_end, child_end = multiprocessing.get_context("spawn").Pipe()
    process = multiprocessing.get_context("spawn").Process(target=live_process, args=(child_end, segment_s))
    process.start()
    yield parent_end.recv()
    parent_end.send("end")
    process.join()


def delays(segment_s: float, seconds: float) -> tuple[list[float], list[float]]:
    """Sample the seconds between a frame at the sender and its force during playback.

    Returns those from the second to the fifth second of playback, and those of the `seconds` after.
    """
    from touchfield.devices import device
    from touchfield.devices.drivers.registry import point_device
    from touchfield.medium.trace import Trace
    from touchfield.network.live_client import open_live
    from touchfield.render.player import Player

    trace = Trace(np.array([0.0, 1e3]), np.zeros((2, 3)))
    settling_s, delays_s = list[float](), list[float]()
    with on_air(segment_s) as (address, zero), open_live(f"ws://{address}/live") as live:
        frames: Any = live.frames
        choice = point_device("sim", trace)
        with Player(live.medium, device("phantom-omni"), choice.opener) as player:
            player.play()
            for i in range(int((5 + seconds) / 0.05)):
                time.sleep(0.05)
                live.keep_up(player)
                if i < 20:
                    continue
                rendered_s = frames.stream_frame(0) / RATE_HZ + player.media_s
                (settling_s if i < 100 else delays_s).append(time.monotonic() - zero - rendered_s)
    return settling_s, delays_s


def large(folder: Path, mib: int) -> Figures:
    """Serve a file of `mib` MiB; count bytes and requests up to its middle segment."""
    from touchfield.container.remote import RemoteFile
    from touchfield.network.server import application
    from touchfield.pipeline.decoding import stream_of

    rng = np.random.default_rng(0)
    encoder = TouchEncoder(GRID, TouchSpec(effort="fast", mode="lossless"))
    noise = ForceField.from_dense(GRID, rng.normal(size=(*GRID.shape, 3)).astype(np.float32))
    body = encoder.encode_segment([noise]).body
    count = -(-(mib << 20) // len(body))
    path = folder / "large.touch"
    with TouchWriter(path) as writer:
        writer.write_head(head(encoder, count))
        for i in range(count):
            writer.write_segment(i, 1, body)
    from aiohttp import web

    loop, address, done = asyncio.new_event_loop(), list[str](), threading.Event()

    async def run() -> None:
        runner = web.AppRunner(application(folder, Access()), access_log=None)
        await runner.setup()
        await web.TCPSite(runner, "127.0.0.1", 0).start()
        address.append(f"http://127.0.0.1:{runner.addresses[0][1]}/large.touch")
        while not done.is_set():
            await asyncio.sleep(0.01)
        await runner.cleanup()

    thread = threading.Thread(target=lambda: loop.run_until_complete(run()), daemon=True)
    thread.start()
    while not address:
        time.sleep(0.01)
    began = time.perf_counter()
    with TouchReader(address[0]) as reader:
        remote: RemoteFile = reader._source.remote  # type: ignore[assignment]
        opening = {"requests": remote.requests, "bytes": remote.received, "segments": count}
        field = stream_of(reader).medium[count // 2]
        took = time.perf_counter() - began
        figures = {
            "file_bytes": reader.size,
            "before_the_segment_bytes": remote.received - len(body) - 32,
            "requests": remote.requests,
            "opening": opening,
            "first_force_s": took,
            "exact": bool(field == noise),
        }
    done.set()
    thread.join()
    return figures


def losses(messages: int) -> Figures:
    """Return the fraction of messages that survive 5 % packet loss, and the overhead.

    The overhead is the fraction of bytes sent beyond those of the messages. Losses are independent, or in
    bursts of five packets on average (Gilbert model).
    """
    rng, rows = np.random.default_rng(1), {}
    for size in (5_000, 20_000, 60_000):
        for name, burst in (("alone", 1.0), ("bursts", 5.0)):
            sending, gathering, sent, arrived, is_bad = Datagrams(7), Gathering(), 0, 0, False
            message = rng.bytes(size)
            for number in range(messages + 1):
                for datagram in sending.add(message) if number < messages else sending.flush():
                    sent += len(datagram)
                    is_bad = rng.random() > 1 / burst if is_bad else rng.random() < 0.05 / (0.95 * burst)
                    arrived += 0 if is_bad else len(gathering.receive(datagram))
            rows[f"{size} bytes, {name}"] = {
                "came": arrived / messages,
                "overhead": sent / messages / size - 1,
            }
    return rows


def coarse_layer_size() -> Figures:
    """Compare the coarse layer of the stereo photograph with its full stream.

    Returns the bytes of both for one frame at n_w 6, their ratio, and the NMSE of the coarse layer.
    """
    from touchfield.codec.registry import field_encoder
    from touchfield.tasks.live import coarse_layer

    prepared, _ = open_sender("sample:motorcycle", EncodeSpec(nw=6))
    coarse, _ = coarse_layer("sample:motorcycle", prepared)
    sizes = [
        len(field_encoder(stream.medium.grid, stream.coding).encode_segment([stream.medium[0]]).body)
        for stream in (prepared, coarse)
    ]
    meter = FidelityMeter(prepared.spec.k, prepared.spec.f0_n)
    meter.add(prepared.medium[0], rebuild_level(coarse.medium[0], prepared.medium.grid))
    return {"bytes": sizes, "share": sizes[1] / sizes[0], "nmse_db": meter.nmse_db}


def layered_losses(messages: int, coarse_fraction: float) -> Figures:
    """Return the fraction of segments in time with a coarse layer, and the overhead.

    The losses are those of `losses`. `coarse_fraction` is the size of the coarse layer relative to a segment.
    """
    rng, rows = np.random.default_rng(2), {}
    for size in (20_000, 60_000):
        for name, burst in (("alone", 1.0), ("bursts", 5.0)):
            channels = [
                (Datagrams(1, REPAIR["fine"]), Gathering(max_open=11)),
                (Datagrams(2, REPAIR["coarse"]), Gathering(max_open=11)),
            ]
            bodies, sent, is_bad = [rng.bytes(size), rng.bytes(round(coarse_fraction * size))], 0, False
            in_time: list[set[int]] = [set(), set()]
            for slot in range(messages + 1):
                for (sending, gathering), body, got in zip(channels, bodies, in_time):
                    message = slot.to_bytes(4, "big") + body[4:]
                    for datagram in sending.add(message) if slot < messages else sending.flush():
                        sent += len(datagram)
                        is_bad = rng.random() > 1 / burst if is_bad else rng.random() < 0.05 / (0.95 * burst)
                        arrived = (
                            []
                            if is_bad
                            else [int.from_bytes(m[:4], "big") for m in gathering.receive(datagram)]
                        )
                        got |= {
                            number for number in arrived if slot <= number + 8
                        }  # the datagrams of a message are spread over 8 slots
            both = in_time[0] | in_time[1]
            rows[f"{size} bytes, {name}"] = {
                "fine": len(in_time[0]) / messages,
                "coarse": len(in_time[1]) / messages,
                "felt": len(both) / messages,
                "overhead": sent / messages / sum(map(len, bodies)) - 1,
            }
    return rows


MODEL = """
<mujoco>
  <option timestep="0.001"/>
  <worldbody>
    <geom name="floor" type="plane" size="0.1 0.1 0.01"/>
    <body name="ball" pos="0 0 0.08"><freejoint/><geom type="sphere" size="0.02"/></body>
    <body name="box" pos="0.03 0.02 0.05" euler="20 10 0">
      <freejoint/><geom type="box" size="0.015 0.02 0.01"/>
    </body>
    <body name="arm" pos="-0.06 0 0.05">
      <joint type="hinge" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0.03 0 0" size="0.008"/>
    </body>
  </worldbody>
</mujoco>
"""


def bodies(folder: Path, seconds: int) -> Figures:
    """Code a simulation at 1 kHz as bodies and as fields, in segments of a quarter of a second.

    Returns the bytes of the first second of both, in which bodies fall, bytes of the opening, the largest
    error of the bodies in units of the error bound, and the time that simulating and coding a second takes.
    """
    from touchfield.tasks.live import PreparedBodies

    (folder / "model.xml").write_text(MODEL)
    spec = EncodeSpec(nw=6, representation="object", source=SourceOptions(seconds=float(seconds)))
    prepared, sender = open_sender(str(folder / "model.xml"), spec)
    assert isinstance(prepared, PreparedBodies) and prepared.objects is not None
    sizes, ratios, took_s = list[int](), list[float](), 0.0
    for segment in range(4 * seconds):
        began_s = time.perf_counter()
        poses = [prepared.bodies.poses(250 * segment + i, print) for i in range(250)]
        coded = prepared.bodies.encoder.encode_frames(poses)
        took_s += time.perf_counter() - began_s
        sizes.append(len(coded.body))
        ratios.append(np.inf if coded.max_error is None else coded.max_error.ratio)
    voxels = TouchEncoder(prepared.medium.grid, TouchSpec(effort="fast"))
    of_fields = sum(
        len(voxels.encode_segment([prepared.medium[start + i] for i in range(250)]).body)
        for start in range(0, 1000, 250)
    )
    return {
        "bodies": len(prepared.objects.objects),
        "opening_bytes": len(sender.opening),
        "bytes_a_second": sum(sizes) / seconds,
        "first_second_bytes": sum(sizes[:4]),
        "first_second_bytes_of_fields": of_fields,
        "share": sum(sizes[:4]) / of_fields,
        "worst_mask_ratio": max(ratios),
        "seconds_for_a_second": took_s / seconds,
    }


def measure(seconds: float, receivers: int, messages: int, mib: int, silent: int) -> Figures:
    """Run all parts of the benchmark."""
    coarse_layer = coarse_layer_size()
    with tempfile.TemporaryDirectory() as folder:
        file = large(Path(folder), mib)
        simulated = bodies(Path(folder), 4)
    settling, late = delays(0.25, min(20.0, seconds))
    delay = {
        "segment_s": FRAMES / RATE_HZ,
        "median_s": statistics.median(late),
        "most_s": max(late),
        "most_settling_s": max(settling),
    }
    return {
        "file": file,
        "delay": delay,
        "bodies": simulated,
        "receivers": many(receivers, seconds),
        "crowd": many(20, min(20.0, seconds), silent),
        "losses": losses(messages),
        "coarse": coarse_layer,
        "layered_losses": layered_losses(messages, coarse_layer["share"]),
    }


def bars(figures: Figures) -> list[Bar]:
    """Limit opening, delay, gaps and resources, and require recovery from losses."""
    file, delay, air, crowd, loss_rows = (
        figures[key] for key in ("file", "delay", "receivers", "crowd", "losses")
    )
    settling_s = delay.get("most_settling_s")
    layered = figures["layered_losses"].values()
    large_rows = [row for name, row in loss_rows.items() if name.startswith("60000")]
    return [
        at_most("bytes before the first segment of a large file", file["before_the_segment_bytes"], 65536),
        at_most("requests to open it", file["opening"]["requests"], 3),
        at_most(
            "delay from frame to force beyond a segment, median",
            delay["median_s"] - delay["segment_s"],
            0.1,
            "s",
        ),
        at_most("the same at worst", delay["most_s"] - delay["segment_s"], 0.1, "s"),
        at_most(
            "the same at worst from the second second of playback to the fifth",
            None if settling_s is None else settling_s - delay["segment_s"],
            0.1,
            "s",
        ),
        at_most(
            "bytes of live bodies at 1 kHz, share of their fields'", figure(figures, "bodies", "share"), 0.1
        ),
        at_most(
            "their largest error, in units of the bound", figure(figures, "bodies", "worst_mask_ratio"), 1.0
        ),
        at_most(
            "seconds to simulate and code a second of them",
            figure(figures, "bodies", "seconds_for_a_second"),
            1.0,
        ),
        at_most(f"gaps of {air['receivers']} receivers", air["gaps"] + air["skipped"], 0),
        at_least("seconds that they listen", air["seconds"], 600, "s"),
        at_most("cores of the sender", air["cores"], 1),
        at_most("growth of its memory", air["memory_mib"][1] - air["memory_mib"][0], 4, "MiB"),
        at_most(f"gaps of 20 beside {crowd['silent']:,} silent connections", crowd["gaps"], 0),
        at_least(
            "segments of 60 kB that come through 5 % losses", min(row["came"] for row in large_rows), 0.999
        ),
        at_most("bytes beyond theirs", max(row["overhead"] for row in large_rows), 0.3),
        at_least(
            "segments of 20 kB", min(r["came"] for n, r in loss_rows.items() if n.startswith("20000")), 0.999
        ),
        at_most("bytes of a coarse layer, share of the stream's", figures["coarse"]["share"], 0.25),
        at_least(
            "segments felt with it, at least coarse, 5 % losses", min(row["felt"] for row in layered), 0.999
        ),
        at_least("of the coarse layer alone", min(row["coarse"] for row in layered), 0.999),
        at_most("bytes beyond those of both layers", max(row["overhead"] for row in layered), 0.3),
    ]


if __name__ == "__main__":
    bench(
        "broadcast", __doc__, measure, bars, seconds=(600.0, 4.0), receivers=(200, 20), messages=(8000, 200),
        mib=(1024, 16), silent=(10_000, 200),
    )  # fmt: skip
