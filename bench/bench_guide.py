"""Measures the guidance from a depth camera: obstacles in the right direction, false alarms, steps and holes,
and the delay from a frame to the actuators.

    python bench/bench_guide.py [--quick] [--seconds S] [--walks N] [--frames N]

Corridors with ground truth (``tests/corridor_makers.py``): walls, boxes, poles, people who stand or walk,
raised floors and holes, seen by a Kinect-like camera at 1.35 m that looks down by 20 degrees, at the pixels
that the guidance uses. A person walks at 0.9 m/s, sways, looks around, and dodges obstacles late. Poses have
errors of 5 mm and 0.2 degrees, and 1 % of the frames are blind. The seeds are held out: the guidance was
developed on the corridors 101 to 110, and no threshold was chosen on those from `FIRST_SEED` on.

*in view*: of the obstacles with at least 15 of these pixels and their nearest visible point within 2 m, the
share of frames in which the direction (one of eight) of that point is near, at its distance or nearer.
*remembered*: the same for the nearest point of obstacles that stood still and left the picture within 10 s.
*shown free* is the share of these that are free, which must never happen; the rest is unknown. *Surfaces* are
the directions, of all eight, with any surface within 1.8 m, the walls and what was never seen included.
*Clear* directions have no surface within 2.5 m: what is not shown free there is the price of the rest. A
*false alarm* starts where a direction becomes near and no surface lies within 2.3 m in it, by up to 3 degrees
and 0.1 s. Steps and drops are also counted in blind frames, which show only the warning. The baseline is the
smallest depth in the columns of each direction, with the ground.

Delay: pictures of 640 x 480 in a folder, shown at 30 Hz, and a device that receives OSC on this machine. TUM
and ICL-NUIM (optional inputs): shares of the states; for ICL, whose depth is exact, also with the noise of a
Kinect against without.
"""

from __future__ import annotations

import math
import resource
import socket
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import numpy as np

from machine import SHARED, Bar, Figures, at_least, at_most, bench, figure
from touchfield.compute.threads import worker_count
from touchfield.guidance import Guide, GuideSpec, Situation
from touchfield.guidance.guide import State
from touchfield.sources.options import SourceOptions
from touchfield.tasks.guide import GuideRun, guide, open_sequence

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import corridor_makers as makers

SIZE, CAMERA = makers.REDUCED, makers.kinect(makers.REDUCED)
RATE_HZ, RANGE_M, FAR_M, MIN_PIXELS = makers.RATE_HZ, 2.0, 2.3, 15
CLOSE_M, CLEAR_M = 1.8, 2.5
FIRST_SEED = 2001
FRONT = np.isin(np.arange(8), (3, 4))
REMEMBERED_FRAMES = round(9.5 * RATE_HZ)
WINDOW = 3
"""Frames by which an alarm may outlast what caused it: 0.1 s."""
NEIGHBOURS_DEG = 3
SETS = {"tum fr1 rpy": ("rgbd_tum_fr1_rpy", 50.0), "icl living room": ("rgbd_iclnuim_livingroom1", 0.0)}
"""Folder of each recording, and how far its camera looks down, degrees."""


class Tally:
    """Counts of one method in one corridor."""

    def __init__(self) -> None:
        self.counts: dict[str, list[int]] = {}
        self.false_alarms = 0
        self.surfaces = np.zeros(3, int)  # directions with a surface within 1.8 m: all, near, free
        self.clear = np.zeros((2, 2), int)  # directions without a surface, in front and elsewhere: all, free
        self._was_false = np.zeros(8, bool)

    def add(self, name: str, state: State, is_found: bool) -> None:
        """Count an obstacle: cases, found, shown free."""
        cases = self.counts.setdefault(name, [0, 0, 0])
        cases[0] += 1
        cases[1] += is_found
        cases[2] += state == State.FREE

    def add_alarms(self, states: np.ndarray, truth_m: np.ndarray) -> None:
        """Count the false alarms that start in a frame, and clear directions that are shown free."""
        for cases, is_side in zip(self.clear, (FRONT, ~FRONT), strict=True):
            is_clear = is_side & (truth_m > CLEAR_M)
            cases += np.count_nonzero(is_clear), np.count_nonzero(is_clear & (states == State.FREE))
        is_false = (states == State.NEAR) & (truth_m > FAR_M)
        self.false_alarms += int((is_false & ~self._was_false).sum())
        self._was_false = is_false


def baseline(depth_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return states and distances by the smallest depth in the columns of each direction."""
    azimuths = np.degrees(np.arctan((np.arange(SIZE[0]) - CAMERA.cx) / CAMERA.fx))
    sectors = np.floor((azimuths + 180) / 45).astype(int)
    nearest = np.where(depth_m > 0, depth_m, np.inf).min(axis=0)
    distances = np.array([nearest[sectors == s].min(initial=np.inf) for s in range(8)])
    states = np.where(distances < RANGE_M, State.NEAR, State.FREE)
    states[~np.isin(np.arange(8), sectors)] = State.UNKNOWN
    return states, distances


class Walk:
    """One corridor: the counts of the guidance with and without poses, and of the baseline."""

    def __init__(self, seed: int, seconds: float) -> None:
        self.scene = makers.corridor(seed, seconds)
        self.rng, self.frames = np.random.default_rng(seed), round(seconds * RATE_HZ)
        self.guides = {"with poses": Guide(CAMERA, *SIZE), "without poses": Guide(CAMERA, *SIZE)}
        self.tallies = {name: Tally() for name in (*self.guides, "baseline")}
        self.seen: dict[int, int] = {}
        self.ground: dict[str, list[int]] = {}
        self._truths: list[np.ndarray] = []
        self._was_false_ground = [False, False]
        self.processor_s = dict.fromkeys(self.guides, 0.0)

    @classmethod
    def walked(cls, seed: int, seconds: float) -> Walk:
        """Return a corridor whose end is reached."""
        walk = cls(seed, seconds)
        for number in range(walk.frames):
            walk.step(number, number / RATE_HZ)
        return walk

    def step(self, number: int, time_s: float) -> None:
        """Evaluate one frame."""
        pose, bodies = self.scene.pose(time_s), self.scene.near(time_s)
        exact, index = makers.exact_depth(bodies, pose, CAMERA, SIZE)
        depth = makers.with_noise(exact, self.rng)
        if self.rng.random() < 0.01:  # a blind frame
            depth[:] = 0
        tracked = makers.as_pose(pose)
        tracked[:3, 3] += self.rng.normal(size=3) * 0.005
        tracked[:3, :3] = tracked[:3, :3] @ makers.small_turn(self.rng, 0.2)
        found: dict[str, tuple[np.ndarray, np.ndarray]] = {"baseline": baseline(depth)}
        for name, one in self.guides.items():
            start_s = process_time()
            situation = one.update(depth, time_s, tracked if name == "with poses" else None)
            self.processor_s[name] += process_time() - start_s
            if situation.is_blind:
                assert set(situation.states) == {State.UNKNOWN}
            found[name] = np.array(situation.states), situation.distances_m
            if name == "with poses":
                self.add_ground(situation, pose)
        if depth.any():
            self.add_obstacles(number, found, (bodies, exact, index, depth, pose))
            self.add_alarms(found, bodies, pose)

    def add_obstacles(self, number: int, found: dict[str, Any], view: tuple[Any, ...]) -> None:
        """Count obstacles within 2 m that are in view, or were."""
        bodies, exact, index, depth, pose = view
        for place, body in enumerate(bodies):
            if not body.is_obstacle:
                continue
            is_body = (index == place) & (depth > 0)
            identity = hash((body.kind, round(body.low[0], 3), body.radius))
            is_in_view = is_body.sum() >= MIN_PIXELS
            if is_in_view:
                self.seen[identity] = number
                distance, azimuth = nearest_visible(exact, is_body, pose)
            else:
                distance, azimuth = makers.nearest_point(body, pose)
            was_seen = number - self.seen.get(identity, -(10**9)) < REMEMBERED_FRAMES
            if distance >= RANGE_M or not (is_in_view or (was_seen and body.kind != "walker")):
                continue
            sector = int((azimuth + 180) // 45) % 8
            group = "in view" if is_in_view else "remembered"
            for name, (states, distances) in found.items():
                if group == "remembered" and name != "with poses":
                    continue  # these remember nothing
                is_found = states[sector] == State.NEAR and distances[sector] < distance + 0.3
                self.tallies[name].add(group, states[sector], is_found)
                self.tallies[name].add(f"{group}, {body.kind}", states[sector], is_found)

    def add_alarms(self, found: dict[str, Any], bodies: list[Any], pose: np.ndarray) -> None:
        """Count false alarms against the nearest surfaces of the last 0.1 s."""
        floor = max(float(self.scene.floor_m(pose[0, 3], pose[2, 3])), 0.0)
        plan = makers.plan_distances(bodies, pose, floor)
        wide = np.concatenate([plan[-NEIGHBOURS_DEG:], plan, plan[:NEIGHBOURS_DEG]])
        truth = np.array([wide[45 * s : 45 * s + 45 + 2 * NEIGHBOURS_DEG].min() for s in range(8)])
        self._truths = [*self._truths[-WINDOW:], truth]
        inside = slice(NEIGHBOURS_DEG, 45 - NEIGHBOURS_DEG)
        has_surface = plan.reshape(8, 45)[:, inside].min(axis=1) < CLOSE_M
        for name, (states, _) in found.items():
            tally = self.tallies[name]
            tally.add_alarms(states, np.min(self._truths, axis=0))
            tally.surfaces += [
                np.count_nonzero(has_surface & is_state)
                for is_state in (states >= 0, states == State.NEAR, states == State.FREE)
            ]

    def add_ground(self, situation: Situation, pose: np.ndarray) -> None:
        """Count steps up and drops from 0.8 to 1.9 m ahead, and those reported where there is none."""
        truths = makers.floor_ahead(self.scene, pose)
        is_flat = makers.is_flat_around(self.scene, pose)
        for n, (name, truth, reported) in enumerate(zip(("step", "drop"), truths, situation.ahead)):
            cases = self.ground.setdefault(name, [0, 0, 0])
            if 0.8 < truth < 1.9:
                cases[0] += 1
                cases[1] += reported < 2.2
            is_false = is_flat and reported < RANGE_M
            cases[2] += is_false and not self._was_false_ground[n]
            self._was_false_ground[n] = is_false


def nearest_visible(exact: np.ndarray, is_body: np.ndarray, pose: np.ndarray) -> tuple[float, float]:
    """Return the distance and direction, degrees, of the nearest visible point of a body."""
    v, u = np.nonzero(is_body)
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(len(u))], 1)
    plan = ((rays * exact[is_body][:, None]) @ pose[:3, :3].T)[:, [0, 2]]
    nearest = plan[np.argmin(np.hypot(*plan.T))]
    forward, right = makers.heading(pose)
    return float(np.hypot(*nearest)), math.degrees(math.atan2(nearest @ right, nearest @ forward))


def corridors(count: int, seconds: float) -> Figures:
    """Walk through `count` corridors; return shares of all of them."""
    seeds = range(FIRST_SEED, FIRST_SEED + count)
    with ProcessPoolExecutor(min(count, worker_count()), get_context("spawn")) as pool:
        walks = list(pool.map(Walk.walked, seeds, count * [seconds]))
    minutes = count * seconds / 60
    figures: Figures = {"minutes": minutes}
    for name in walks[0].tallies:
        totals: dict[str, np.ndarray] = {}
        for walk in walks:
            for key, cases in walk.tallies[name].counts.items():
                totals[key] = totals.get(key, np.zeros(3, int)) + cases
        alarms = sum(walk.tallies[name].false_alarms for walk in walks)
        surfaces = np.sum([walk.tallies[name].surfaces for walk in walks], axis=0)
        clear = np.sum([walk.tallies[name].clear for walk in walks], axis=0)
        figures[name] = {
            **{key: share(totals[key], 1) for key in sorted(totals)},
            **{
                f"{key}, shown free": share(totals[key], 2)
                for key in ("in view", "remembered")
                if key in totals
            },
            "surfaces, near": share(surfaces, 1),
            "surfaces, shown free": share(surfaces, 2),
            "clear in front, shown free": share(clear[0], 1),
            "clear elsewhere, shown free": share(clear[1], 1),
            "in view, frames": int(totals["in view"][0]) if "in view" in totals else 0,
            "false alarms a minute": alarms / minutes,
        }
    for name in ("step", "drop"):
        cases = np.sum([walk.ground[name] for walk in walks], axis=0)
        figures[name] = {
            "found": share(cases, 1),
            "frames": int(cases[0]),
            "false a minute": cases[2] / minutes,
        }
    frames = sum(walk.frames for walk in walks)
    for name in walks[0].guides:
        spent = sum(walk.processor_s[name] for walk in walks)
        figures[name]["processor ms a frame"] = 1e3 * spent / frames
    return figures


def share(cases: np.ndarray, which: int) -> float | None:
    """Return a share of the cases; None without any."""
    return float(cases[which] / cases[0]) if cases[0] else None


def delay(frames: int) -> Figures:
    """Guide in real time from a folder of pictures to a device on this machine."""
    from PIL import Image

    scene, rng = makers.corridor(2, frames / RATE_HZ), np.random.default_rng(0)
    camera = makers.kinect(makers.VGA)
    with TemporaryDirectory() as name, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        folder, poses = Path(name), []
        (folder / "depth").mkdir()
        for n in range(frames):
            pose = scene.pose(n / RATE_HZ)
            exact, _ = makers.exact_depth(scene.near(n / RATE_HZ), pose, camera, makers.VGA)
            depth = np.rint(1000 * makers.with_noise(exact, rng)).astype(np.uint16)
            Image.fromarray(depth).save(folder / "depth" / f"{n:05d}.png", compress_level=1)
            poses.append(" ".join(f"{x:.9f}" for x in makers.as_pose(pose)[:3].ravel()))
        (folder / "poses.txt").write_text("\n".join(poses) + "\n")
        intrinsics = f"{camera.fx},{camera.fy},{camera.cx},{camera.cy}"
        options = SourceOptions(
            depth_scale=1000.0, intrinsics=intrinsics, source_rate_hz=RATE_HZ, world="frames"
        )
        run = GuideRun(device=f"osc:127.0.0.1:{line.getsockname()[1]}", profile="tactsuit-x40")
        start_s = process_time()
        figures, _ = guide(folder, run, options)
        spent_s = process_time() - start_s
    keys = ("evaluated", "dropped", "late", "delay_p50_ms", "delay_p99_ms", "delay_max_ms")
    return {
        **{key: figures[key] for key in keys},
        "processor ms a frame": 1e3 * spent_s / max(figures["evaluated"], 1),
        "peak memory, MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def recordings() -> Figures:
    """Evaluate the optional inputs; empty without them."""
    figures: Figures = {}
    for title, (folder, pitch_deg) in SETS.items():
        path, spec = SHARED / folder, GuideSpec(pitch_deg=pitch_deg)
        if not path.is_dir():
            continue
        sequence = open_sequence(path, SourceOptions(world="frames"))
        assert sequence.poses is not None
        camera = sequence.intrinsics, sequence.width, sequence.height
        clean, noisy = Guide(*camera, spec), Guide(*camera, spec)
        rng, states, same, errors, spent_s, grounds = np.random.default_rng(0), [], [], [], 0.0, 0
        for n in range(sequence.frame_count):
            depth, pose = sequence.depth_m(n), sequence.poses[n]
            start_s = process_time()
            situation = clean.update(depth, n / RATE_HZ, pose)
            spent_s += process_time() - start_s
            states.append(situation.states)
            grounds += situation.ground.is_seen
            if title.startswith("icl"):
                with_noise = makers.with_noise(np.where(depth > 0, depth, np.inf), rng)
                other = noisy.update(with_noise, n / RATE_HZ, pose)
                same.append(np.equal(situation.states, other.states))
                both = np.isfinite(situation.distances_m) & np.isfinite(other.distances_m)
                errors.append(np.abs(situation.distances_m[both] - other.distances_m[both]))
        shares = {state.name.lower(): float((np.array(states) == state).mean()) for state in State}
        figures[title] = {
            "frames": sequence.frame_count, "with ground": grounds / sequence.frame_count, **shares,
            "processor ms a frame": 1e3 * spent_s / sequence.frame_count,
        }  # fmt: skip
        if same:
            differences = np.concatenate(errors)
            figures[title] |= {
                "states as without noise": float(np.mean(same)),
                "distance, median difference, mm": 1e3 * float(np.median(differences)),
                "distance, p95 difference, mm": 1e3 * float(np.percentile(differences, 95)),
            }
    return figures


def measure(seconds: float, walks: int, frames: int) -> Figures:
    """Measure corridors, delay and recordings."""
    return {
        "corridor": corridors(walks, seconds),
        "delay": delay(frames),
        "recordings": recordings(),
    }


def bars(figures: Figures) -> list[Bar]:
    """Require what the guidance promises of its ground truth."""
    walk = figure(figures, "corridor", "with poses")
    alone = figure(figures, "corridor", "without poses")
    return [
        at_least("obstacles in view within 2 m in the right direction", figure(walk, "in view"), 0.95),
        at_least("the same without poses", figure(alone, "in view"), 0.95),
        at_most("obstacles in view that are shown free", figure(walk, "in view, shown free"), 0.01),
        at_most("surfaces that are shown free, with poses", figure(walk, "surfaces, shown free"), 0.01),
        at_most("the same without poses", figure(alone, "surfaces, shown free"), 0.01),
        at_most("false alarms, with poses", figure(walk, "false alarms a minute"), 1.0, "/min"),
        at_most("false alarms, without poses", figure(alone, "false alarms a minute"), 1.0, "/min"),
        at_least("drops from 0.8 to 1.9 m ahead", figure(figures, "corridor", "drop", "found"), 0.95),
        at_least("steps from 0.8 to 1.9 m ahead", figure(figures, "corridor", "step", "found"), 0.95),
        at_most("frame to actuator, p99", figure(figures, "delay", "delay_p99_ms"), 100.0, "ms"),
        at_most("processor time of a frame", figure(figures, "delay", "processor ms a frame"), 33.0, "ms"),
    ]


if __name__ == "__main__":
    bench(
        "guide", __doc__, measure, bars,
        seconds=(60.0, 6.0), walks=(8, 1), frames=(300, 45),
    )  # fmt: skip
