"""Measures a base layer of coder `touch` that is made of the coded source: the planes of a depth map.

    python bench/bench_source_layer.py [--quick] [--frames N]

For each frame of the walls of ``rate_fields`` at n_w 6 and 7, within the error bound (k = 0.1, F_0 = 0.05 N):

* today: bytes of coder `touch`, a frame by itself.
* layer: bytes of the head and the tree of planes (`source_layer_tree`), which are read again.
* corrections: bytes of the voxel pass with the field of these planes (`source_layer_field`) as its reference,
  decoded again by ``c/touch.h`` (`source_layer_pass`).
* ratio: today plus what the base layer changes, over today. `kept` is the smaller of both, as a mode decision
  takes it.

The tree's price of a wrong pixel is the best of `PRICES` for the first frame. Segments are the first frames,
coded together, with the better way for each frame. "JPEG XL of the map" codes the exact map at effort 9. The
best other coder is that of the stored ``results/rate.json``, of the first frame. Meshes have no map; their
rows compare coder `touch` with the mesh itself by Draco, at 10 bits a coordinate, before any correction.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rate_ours as ours
import rate_peers as peers
from machine import SHARED, Bar, Figures, at_most, bench, leave_out, stored
from rate_fields import Case, cases
from rate_source import Source, map_bytes
from source_layer_field import Lattice, field_of, lattice_of, surface_of
from source_layer_pass import FrameCost, Layer, frame_costs, library, unit_n
from source_layer_tree import Planes, Tolerance, fit_tree, read_tree, write_tree
from touchfield.filters.device_spec import DeviceFilter
from touchfield.medium import ForceField
from touchfield.pipeline import prepare
from touchfield.pipeline.source import open_scene
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.camera import noise_step_per_m
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.laws import profile_of

PRICES = (1.0, 2.0, 4.0, 8.0)
"""Bits of a wrong picture, in multiples of those of the frame today."""
LENGTH_M, ANGLE = 1e-4, 0.2
"""Errors at which a pixel counts as half wrong: metres of the hand, and rad."""
CHUNK = 10
"""Frames that a process measures."""
SEGMENT = 5
MAPS = 6
"""Every so many frames, the map is coded by JPEG XL."""
MESHES = {"spot": "spot/spot_triangulated.obj", "featuretype": "featuretype/featuretype.STL"}
DRACO_BITS = 10
NEVER, NO_VECTORS = 1 << 40, np.zeros((0, 512, 3), np.int32)
"""A base layer that is never better."""


@dataclass(frozen=True)
class Walls:
    """The frames of a wall, and the base layers of their depth maps."""

    case: Case

    @cached_property
    def prepared(self) -> Any:
        """The medium, with its device and placement."""
        return prepare(self.case.source, self.case.spec)

    @cached_property
    def scene(self) -> DepthScene:
        """The scene that the walls are made of."""
        sequence = Source(self.case, 1).sequence
        return DepthScene(sequence, step_per_m=noise_step_per_m(sequence.depth_m(0)))

    @cached_property
    def mapping(self) -> DeviceFilter:
        """The device filter, with the force law."""
        at, spec = self.prepared, self.case.spec
        law = spec.law_spec(at.device.force_max_n)
        profile = profile_of(law, law.saturation_m)
        return DeviceFilter(at.device, at.medium.grid, at.placement, profile, spec.device_filter)

    def lattice(self, index: int, unit: float) -> Lattice:
        """Return the head of a frame's base layer; `unit` is that of the segment, newtons."""
        sequence, scene = self.scene.sequence, self.scene
        size_px = sequence.height, sequence.width
        return lattice_of(self.mapping, scene.pose(index), sequence.intrinsics, size_px, unit)

    def layer(self, index: int, frame: ForceField, unit: float, bits: float) -> Layer:
        """Return the base layer of a frame, as a receiver makes it.

        `bits` is the price of a wrong picture.
        """
        lattice = self.lattice(index, unit)
        counts = samples_by_pixel(frame, lattice)
        surface = surface_of(self.scene.planes(index), counts * (bits / max(counts.sum(), 1)))
        k = self.scene.sequence.intrinsics
        tree = fit_tree(surface, Tolerance(LENGTH_M / self.mapping.placement.scale, ANGLE, k.fx, k.fy))
        data, planes = write_tree(tree)
        head = lattice.head()
        known = Lattice.read(head, lattice.shape)
        read = read_tree(data, *known.size_px)
        if not is_equal(read, planes):
            raise RuntimeError(f"{self.case.title}, frame {index}: the tree decodes to other planes")
        return Layer(len(head) + len(data) + 2, *field_of(known, read))  # 2: the length of the chunk


def is_equal(a: Planes, b: Planes) -> bool:
    """Return whether two pictures have the same planes."""
    is_surface = ~a.is_hole
    return bool(
        (a.is_hole == b.is_hole).all() and (a.coefficients[is_surface] == b.coefficients[is_surface]).all()
    )


def samples_by_pixel(frame: ForceField, lattice: Lattice) -> NDArray[np.int64]:
    """Count the samples of the finer lattice in supported voxels by their pixel, int64 [height, width]."""
    (height, width), rule = lattice.size_px, lattice.rule
    fine = 2 * frame.positions().astype(np.int64)[:, None] + np.indices((2, 2, 2)).reshape(3, -1).T
    u_z, v_z, z = (rule.lattice[0] + fine.reshape(-1, 3) @ rule.lattice[1:]).T
    is_ahead = z > 0
    u, v = ((2 * a[is_ahead] + z[is_ahead]) // (2 * z[is_ahead]) for a in (u_z, v_z))
    is_seen = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    counts = np.bincount(v[is_seen] * width + u[is_seen], minlength=height * width)
    return counts.astype(np.int64).reshape(height, width)


def best_price(walls: Walls) -> float:
    """Return the price of a wrong picture that takes the fewest bytes in the first frame."""
    frame = walls.prepared.medium[0]
    unit, bits = unit_n([frame]), 8 * ours.touch([frame]).bytes

    def size(price: float) -> int:
        layer = walls.layer(0, frame, unit, bits * price)
        return layer.bytes + frame_costs([frame], [layer])[0].corrections

    return min(PRICES, key=size)


def frame_row(walls: Walls, index: int, price: float) -> Figures:
    """Measure a frame by itself."""
    frame = walls.prepared.medium[index]
    today = ours.touch([frame]).bytes
    layer = walls.layer(index, frame, unit_n([frame]), 8 * today * price)
    cost: FrameCost = frame_costs([frame], [layer])[0]
    total = today - cost.other + layer.bytes + cost.corrections
    return {
        "today_bytes": today,
        "layer_bytes": layer.bytes,
        "correction_bytes": cost.corrections,
        "ratio": total / today,
        "kept_ratio": min(total / today, 1.0),
        "within_fraction": cost.within_fraction,
    }


def segment_row(walls: Walls, price: float) -> Figures:
    """Measure the first frames in one segment."""
    frames = [walls.prepared.medium[n] for n in range(min(SEGMENT, len(walls.prepared.medium)))]
    unit, bits = unit_n(frames), 8 * ours.touch(frames[:1]).bytes
    layers = [walls.layer(n, frame, unit, bits * price) for n, frame in enumerate(frames)]
    today, costs = ours.touch(frames).bytes, frame_costs(frames, layers)
    plain = frame_costs(frames, [Layer(NEVER, frame.bricks[:0], NO_VECTORS) for frame in frames])
    return {
        "segment_today_bytes": today,
        "segment_layer_bytes": today - sum(c.bytes for c in plain) + sum(c.bytes for c in costs),
        "segment_layers": sum(c.has_layer for c in costs),
    }


def chunk_rows(case: Case, indices: list[int], price: float) -> list[Figures]:
    """Measure some frames, in a process of their own."""
    os.environ["TOUCHFIELD_THREADS"] = "1"
    walls = Walls(case)
    return [frame_row(walls, n, price) for n in indices]


def first_figures(case: Case) -> tuple[float, Figures]:
    """Return the price of a case, and its segment, in a process of their own."""
    os.environ["TOUCHFIELD_THREADS"] = "1"
    walls = Walls(case)
    price = best_price(walls)
    return price, segment_row(walls, price)


def maps_of(case: Case, indices: list[int]) -> list[int]:
    """Return the bytes of the exact maps of some frames by JPEG XL; empty if it is not installed."""
    if not peers.module("JPEG XL"):
        return []
    source = Source(case, max(indices) + 1)
    return [map_bytes(source.maps[n : n + 1] // source.unit, True) for n in indices]


def summary(case: Case, price: float, rows: list[Figures]) -> Figures:
    """Return the mean figures of the frames of a case, and the spread of the ratio."""
    ratios = np.array([row["ratio"] for row in rows])
    names = "today_bytes", "layer_bytes", "correction_bytes", "within_fraction"
    found: Figures = {"field": case.title, "frames": len(rows), "price": price}
    found |= {name: float(np.mean([row[name] for row in rows])) for name in names}
    found |= {
        "ratio": geometric(ratios),
        "least_ratio": float(ratios.min()),
        "largest_ratio": float(ratios.max()),
    }
    return found | {"kept_ratio": geometric(row["kept_ratio"] for row in rows)}


def geometric(ratios: Iterable[float]) -> float:
    """Return the geometric mean."""
    return math.exp(float(np.mean(np.log(list(ratios)))))


def best_peer(title: str) -> float | None:
    """Return the bytes of the best other coder in the stored results, within the bound; None without them."""
    for row in stored("rate").get("sizes", ()):
        if (row["field"], row["at"], row["frames"]) == (title, "promise", 1):
            return float(min(size for size in row["peers"].values() if size and math.isfinite(size)))
    return None


def mesh_row(name: str, nw: int) -> Figures:
    """Compare a mesh's field with the mesh itself."""
    path, spec = str(SHARED / "meshes" / MESHES[name]), EncodeSpec(nw=nw)
    today = ours.touch([prepare(path, spec).medium[0]]).bytes
    row: Figures = {"mesh": f"{name}, nw {nw}", "today_bytes": today}
    if peers.module("Draco"):
        scene: Any = open_scene(path, spec.source)
        size = draco_bytes(scene.surface.vertices_m, scene.surface.triangles)
        row |= {"draco_peer": size, "draco_peer_ratio": size / today}
    return row


def draco_bytes(vertices_m: NDArray[Any], triangles: NDArray[Any]) -> int:
    """Return the bytes of a mesh by Draco."""
    vertices = np.ascontiguousarray(vertices_m, np.float32)
    code = peers.module("Draco").encode(
        vertices, triangles.astype(np.uint32), quantization_bits=DRACO_BITS, compression_level=10
    )
    return len(code)


def measure(frames: int, sides: str) -> Figures:
    """Measure walls, segments, maps and meshes."""
    if not SHARED.is_dir():
        leave_out("the walls of ../shared/data, which is not there")
    library()  # compiled once; every process loads it
    walls = [c for c in cases(tuple(int(n) for n in sides.split(","))) if c.kind == "band"]
    indices = [list(range(n, min(n + CHUNK, frames))) for n in range(0, frames, CHUNK)]
    rows = []
    with ProcessPoolExecutor(2) as pool:
        firsts = list(pool.map(first_figures, walls))
        by_name = {c.name: c for c in walls}
        maps = {name: pool.submit(maps_of, c, list(range(0, frames, MAPS))) for name, c in by_name.items()}
        parts = [
            [pool.submit(chunk_rows, c, part, price) for part in indices]
            for c, (price, _) in zip(walls, firsts)
        ]
        for case, (price, segment), part in zip(walls, firsts, parts):
            row = summary(case, price, [row for done in part for row in done.result()])
            coded = maps[case.name].result()
            row |= {"map_peer": float(np.mean(coded)) if coded else None, "best_peer": best_peer(case.title)}
            rows.append(
                row
                | segment
                | {"segment_ratio": segment["segment_layer_bytes"] / segment["segment_today_bytes"]}
            )
    meshes = [mesh_row(name, int(n)) for n in sides.split(",") for name in MESHES]
    mean = {
        "mean_ratio": geometric(row["kept_ratio"] for row in rows),
        "mean_segment_ratio": geometric(min(row["segment_ratio"], 1.0) for row in rows),
    }
    return {**mean, "walls": rows, "meshes": meshes}


def bars(figures: Figures) -> list[Bar]:
    """Compare the means with 10 % fewer bytes."""
    name = "bytes with a base layer over those today, the smaller of both, mean of the walls"
    return [
        at_most(f"{name}: one frame", figures["mean_ratio"], 0.9),
        at_most(f"{name}: {SEGMENT} frames", figures["mean_segment_ratio"], 0.9),
    ]


if __name__ == "__main__":
    bench(
        "source_layer",
        __doc__,
        measure,
        bars,
        reads=("bench/source_layer.c",),
        frames=(20, 1),
        sides=("6,7", "6"),
    )
