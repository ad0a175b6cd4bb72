"""A tool of many points: force and torque equal the integral over its surface, in any orientation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from tick_makers import GRID, OMNI, Bench, Vector, constant, points

from touchfield.compute.native import native
from touchfield.devices import device
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid
from touchfield.medium.cells import CellPool
from touchfield.medium.pose_track import rotation_matrices
from touchfield.render.block import Memory, aligned, layout
from touchfield.render.block.frames import FramePart, field_bytes, frame_bytes, write_field, write_frame
from touchfield.render.spec import RenderSpec
from touchfield.render.tool import MAX_POINTS, Tool, tool_bytes, write_tool

SIGMA = device("sigma.7")
Law = Callable[[Vector], Vector]


def box(x: float, y: float, z: float, points: int) -> Tool:
    """A box of these sides about the device's point, with inverted triangles."""
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) * (x / 2, y / 2, z / 2)
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])[:, ::-1]
    return Tool.of_triangles(corners, triangles, points, "box")


def unit(*wxyz: float) -> Vector:
    q = np.array(wxyz, np.float64)
    return q / np.linalg.norm(q)


def integral(
    sides: Vector, position: Vector, turn: Vector, law: Law, steps: int = 200
) -> tuple[Vector, Vector]:
    """Force and torque of a box, by the midpoint rule on each face: dA max(0, -n F / |F|) F over A / 4."""
    force, torque, area = np.zeros(3), np.zeros(3), 0.0
    middles = (np.arange(steps) + 0.5) / steps - 0.5
    for axis in range(3):
        others = [n for n in range(3) if n != axis]
        for sign in (-1.0, 1.0):
            u, v = np.meshgrid(middles * sides[others[0]], middles * sides[others[1]], indexing="ij")
            points_m = np.zeros((steps * steps, 3))
            points_m[:, others[0]], points_m[:, others[1]], points_m[:, axis] = (
                u.ravel(),
                v.ravel(),
                sign * sides[axis] / 2,
            )
            levers, normal = points_m @ turn.T, turn[:, axis] * sign
            f = law(position + levers)
            size = np.linalg.norm(f, axis=1)
            facing = np.maximum(0.0, -(f @ normal)) / np.where(size > 0, size, 1.0)
            face = sides[others[0]] * sides[others[1]]
            weighted = f * facing[:, None] * face / steps**2
            force, torque = force + weighted.sum(axis=0), torque + np.cross(levers, weighted).sum(axis=0)
            area += face
    return force / (area / 4), torque / (area / 4)


def ball(radius: float, stiffness: float) -> Law:
    """A soft ball about the origin: stiffness times the depth, outwards."""

    def law(p: Vector) -> Vector:
        distance = np.linalg.norm(p, axis=-1, keepdims=True)
        depth = np.maximum(radius - distance, 0.0)
        return stiffness * depth * p / np.where(distance > 0, distance, 1.0)

    return law


class ToolBlock:
    """A block with one or two frames and a tool; without ticks."""

    def __init__(self, tool: Tool, grid: Grid, *laws: Law, parts: tuple[FramePart, ...] = ()) -> None:
        pools = [
            CellPool.of(ForceField.from_dense(grid, law(points(grid)).astype(np.float32))) for law in laws
        ]
        tool_at = layout.RECEIVER.itemsize
        first = aligned(tool_at + tool_bytes(tool))
        offsets = first + np.cumsum([0, *map(field_bytes, pools)])
        self.frames = [int(offsets[-1]) + n * frame_bytes(2) for n in range(max(len(pools), 1))]
        self.memory = Memory.empty(self.frames[-1] + frame_bytes(2))
        for position, pool in zip(offsets, pools, strict=False):
            write_field(self.memory, int(position), pool)
        for n, frame in enumerate(self.frames):
            parts_of_frame = [replace(part, field_at=int(offsets[n])) for part in parts] or [
                FramePart.voxels(int(offsets[n]))
            ]
            write_frame(self.memory, frame, parts_of_frame, np.inf if not parts else 1e3)
        write_tool(self.memory, tool_at, tool)
        self.tool = tool

    def wrench(self, position: Vector, turn: Vector, blend: float = 0.0) -> tuple[Vector, Vector]:
        self.memory.receiver["state"]["tool_rotation"] = turn
        frames = self.frames[0], self.frames[-1]
        both = native.tool_force(self.memory.bytes, *frames, blend, *map(float, position))
        return np.array(both[:3]), np.array(both[3:])

    def by_points(self, position: Vector, turn: Vector, blend: float = 0.0) -> tuple[Vector, Vector]:
        """The same by `force_at` at each point."""
        force, torque = np.zeros(3), np.zeros(3)
        for parts_of_frame, normal in zip(self.tool.points_m, self.tool.normals, strict=True):
            lever = turn @ parts_of_frame
            f = np.array(
                native.force_at(
                    self.memory.bytes, self.frames[0], self.frames[-1], blend, *(position + lever)
                )
            )
            size = np.linalg.norm(f)
            if size > 0:
                f = f * max(0.0, -(turn @ normal) @ f / size)
            force, torque = force + f, torque + np.cross(lever, f)
        return 4 / len(self.tool) * force, 4 / len(self.tool) * torque


def test_the_torque_of_a_box_in_the_field_of_a_ball_is_the_integral() -> None:
    sides = np.array([0.03, 0.02, 0.012])
    law = ball(0.05, 400.0)
    fine = Grid((131, 131, 131), (0.001,) * 3, (-0.065,) * 3)
    block = ToolBlock(box(*sides, 10_000), fine, law)
    rng, is_large = np.random.default_rng(7), []
    for _ in range(6):
        turn = rotation_matrices(unit(*rng.normal(size=4)))
        position = rng.normal(size=3)
        position *= 0.045 / np.linalg.norm(position)
        force, torque = block.wrench(position, turn)
        expected, about = integral(sides, position, turn, law)
        assert np.linalg.norm(force - expected) < 0.01 * np.linalg.norm(expected)
        error, scale = np.linalg.norm(torque - about), np.linalg.norm(expected) * np.linalg.norm(sides) / 2
        assert error < 0.002 * scale
        is_large.append(np.linalg.norm(about) > 0.05 * scale)
        assert error < 0.01 * np.linalg.norm(about) or not is_large[-1], (torque, about)
    assert sum(is_large) > 3  # the rest are forces through the centre, with hardly any torque


def test_the_wrench_is_the_sum_of_single_points() -> None:
    rng = np.random.default_rng(3)
    tool = Tool.sphere(0.02, 300)
    quaternion = unit(1.0, 0.2, -0.4, 0.1)
    moving = FramePart(0, tuple(quaternion), (0.01, 0.0, -0.02), (0.1, -0.2, 0.05, 1.0, 2.0, -3.0))
    other = FramePart(0, tuple(unit(0.3, 1, 0, 0)), (-0.02, 0.01, 0.0))

    def swirl(p: Vector) -> Vector:
        return 30 * np.cross(p, [1.0, 2.0, -1.0])

    for block in (
        ToolBlock(tool, GRID, ball(0.05, 400.0), swirl),
        ToolBlock(tool, GRID, ball(0.05, 400.0), parts=(moving, other)),
        ToolBlock(tool, GRID, swirl, ball(0.03, 90.0), parts=(moving, other)),
    ):
        for blend in (0.0, 0.3, 1.0):
            position, turn = rng.normal(0, 0.03, 3), rotation_matrices(unit(*rng.normal(size=4)))
            for got, expected in zip(
                block.wrench(position, turn, blend), block.by_points(position, turn, blend), strict=True
            ):
                assert np.abs(got - expected).max() < 1e-5 * max(np.abs(expected).max(), 1e-3)


def test_a_small_sphere_equals_a_point_and_a_convex_tool_does_on_average() -> None:
    block = ToolBlock(Tool.sphere(1e-6, 4000), GRID, constant(0.6, -0.2, 1.1))
    force, torque = block.wrench(np.zeros(3), np.eye(3))
    assert force == pytest.approx([0.6, -0.2, 1.1], rel=2e-3)
    assert np.abs(torque).max() < 1e-8
    block = ToolBlock(box(0.02, 0.01, 0.005, 3000), GRID, constant(0.0, 0.0, 1.0))
    rng = np.random.default_rng(5)
    forces_n = [
        block.wrench(np.zeros(3), rotation_matrices(unit(*rng.normal(size=4))))[0][2] for _ in range(400)
    ]
    assert np.mean(forces_n) == pytest.approx(1.0, rel=0.05)


def test_the_far_side_of_a_thin_plate_does_not_pull_the_tool_through() -> None:
    def plate(p: Vector) -> Vector:  # 4 mm thick, pushing out at the nearer side
        force = np.zeros_like(p)
        z = p[..., 2]
        force[..., 2] = np.where(
            np.abs(z) < 0.002, 500 * (0.002 - np.abs(z)) * np.where(z >= 0, 1.0, -1.0), 0.0
        )
        return force

    fine = Grid((25, 25, 161), (0.002, 0.002, 0.0005), (-0.024, -0.024, -0.04))
    block = ToolBlock(Tool.sphere(0.01, 4000), fine, plate)
    for depth in np.linspace(0.0005, 0.0095, 10):  # from above, until its centre is at the plate
        assert block.wrench(np.array([0, 0, 0.012 - depth]), np.eye(3))[0][2] > 0


def test_a_long_tool_acts_at_its_tip() -> None:
    stick = Tool(np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0]]), np.array([[0.0, 0.0, -1.0]] * 2))
    force, torque = ToolBlock(stick, GRID, constant(0.0, 0.0, 1.0)).wrench(
        np.array([-0.3, 0.0, 0.0]), np.eye(3)
    )
    assert force == pytest.approx([0, 0, 2]) and torque == pytest.approx([0, -0.6, 0])


def test_a_tool_outside_the_field_has_no_force() -> None:
    block = ToolBlock(Tool.sphere(0.01, 50), GRID, constant(1.0, 0.0, 0.0))
    for position in ((5.0, 0, 0), (np.nan, 0, 0), (0, np.inf, 0), (1e300, 0, 0)):
        force, torque = block.wrench(np.array(position), np.eye(3))
        assert not force.any() and not torque.any()


@pytest.mark.parametrize("count", [7, 100, 3001])
def test_points_of_a_mesh_are_even_and_face_outward(count: int) -> None:
    tool = box(0.04, 0.02, 0.01, count)
    assert len(tool) == count
    assert ((tool.points_m * tool.normals).sum(axis=1) > 0).all()
    on_top = (tool.normals[:, 2] > 0.5).sum()
    assert abs(on_top - count * 8 / 28) <= 2
    if count == 3001:
        top = tool.points_m[tool.normals[:, 2] > 0.5]
        counts = np.histogram2d(top[:, 0], top[:, 1], bins=(8, 4), range=((-0.02, 0.02), (-0.01, 0.01)))[0]
        assert counts.min() > 0.8 * counts.mean() and counts.max() < 1.2 * counts.mean()


@pytest.mark.parametrize(
    "make",
    [
        lambda: Tool.sphere(0.0),
        lambda: Tool.sphere(np.nan),
        lambda: Tool.sphere(0.01, 0),
        lambda: Tool.sphere(0.01, MAX_POINTS + 1),
        lambda: Tool(np.zeros((0, 3)), np.zeros((0, 3))),
        lambda: Tool(np.full((2, 3), np.nan), np.eye(3)[:2]),
        lambda: Tool(np.eye(3), 2 * np.eye(3)),
        lambda: Tool(np.eye(3), np.eye(3)[:2]),
        lambda: Tool.of_triangles(np.zeros((3, 3)), np.array([[0, 1, 2]]), 10, "flat"),
        lambda: RenderSpec(tool=Tool.sphere(0.01), coupling_n_per_m=100.0),
        lambda: RenderSpec(peak_nm=-1.0),
    ],
)
def test_invalid_tools_are_refused(make: Callable[[], object]) -> None:
    with pytest.raises(InvalidArgument):
        make()


# -- through the tick --------------------------------------------------------------------------------------


class Grip(Bench):
    """A bench whose device renders a torque, with a tool."""

    def __init__(self, law: Law, tool: Tool, spec: RenderSpec | None = None, **options: object) -> None:
        self.tool = tool
        super().__init__(law, RenderSpec() if spec is None else spec, **{"device": STRAIGHT, **options})  # type: ignore[arg-type]

    def restart(self, spec: RenderSpec) -> tuple[str, ...]:
        notes = super().restart(replace(spec, tool=self.tool))
        top = self.frame + frame_bytes(1)
        if self.memory.size_bytes < top + tool_bytes(self.tool):
            grown = Memory.empty(top + tool_bytes(self.tool))
            grown.bytes[: self.memory.size_bytes] = self.memory.bytes
            self.memory = grown
        write_tool(self.memory, top, self.tool)
        return notes

    def turn(self, w: float, x: float, y: float, z: float) -> None:
        self.memory.receiver["grip"]["orientation"] = (w, x, y, z)

    @property
    def torque(self) -> Vector:
        return self.value("state.torque.output")


STICK = Tool(np.array([[0.05, 0.0, 0.0]]), np.array([[0.0, 0.0, -1.0]]), "stick")
"""One point at 50 mm, whose weight is 4 when it faces the force."""

UP = constant(0.0, 0.0, 0.5)

STRAIGHT = replace(SIGMA, axes="x right, y up, z towards the user")


def test_a_lever_gives_a_torque_and_rotates_with_the_grip() -> None:
    grip = Grip(UP, STICK, RenderSpec(slew_nm_per_s=1e4))
    force = grip.settled(0.0, 0.0, 0.0)
    assert force == pytest.approx([0, 0, 2.0], rel=1e-6)
    assert grip.torque == pytest.approx([0, -0.1, 0], rel=1e-6)  # x by z
    half = np.sqrt(0.5)
    grip.turn(half, 0.0, 0.0, half)  # a quarter turn about z: the lever lies along y
    grip.settled(0.0, 0.0, 0.0)
    assert grip.torque == pytest.approx([0.1, 0, 0], rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("axes", ["x towards the user, y right, z up", "x right, y up, z away from the user"])
def test_force_and_torque_are_those_of_one_lever_in_any_axes(axes: str) -> None:
    """The torque is lever x force in the device's axes, also for left-handed ones."""
    grip = Grip(UP, STICK, RenderSpec(scale=2.0), device=replace(SIGMA, axes=axes))
    force = grip.settled(0.0, 0.0, 0.0)
    axes_matrix = grip.value("settings.axes")
    lever = axes_matrix.T @ STICK.points_m[0] / 2.0
    handed = np.sign(np.linalg.det(axes_matrix))
    assert np.linalg.norm(force) == pytest.approx(2.0, rel=1e-6)
    assert grip.torque == pytest.approx(np.cross(lever, force), rel=1e-6, abs=1e-12), handed


def test_a_device_without_torque_gets_none_and_a_note() -> None:
    grip = Grip(UP, STICK, device=OMNI)
    (note,) = [text for text in grip.restart(RenderSpec()) if "torque" in text]
    assert "phantom-omni" in note
    grip.settled(0.0, 0.0, 0.0)
    assert not grip.torque.any() and grip.value("state.field_torque_nm")[1] == pytest.approx(-0.1, rel=1e-6)
    assert not any("torque" in text for text in Grip(UP, STICK).restart(RenderSpec()))
    with pytest.raises(InvalidArgument, match="peak_nm"):
        grip.restart(RenderSpec(peak_nm=0.1))


def test_an_invalid_orientation_releases_the_torque_until_it_returns() -> None:
    grip = Grip(UP, STICK)
    grip.settled(0.0, 0.0, 0.0)
    torque_nm = grip.torque
    for odd in ((np.nan, 0, 0, 0), (0, 0, 0, 0), (2.0, 0, 0, 0), (np.inf, 0, 0, 0)):
        grip.turn(*odd)
        grip.tick(0.0, 0.0, 0.0)
        first = grip.torque
        assert (
            0 < np.linalg.norm(first) < np.linalg.norm(torque_nm)
            and grip.value("state.field_torque_nm").tolist() == [0] * 3
        )
        grip.settled(0.0, 0.0, 0.0)
        assert not grip.torque.any() and not grip.value("state.force.output").any()
        grip.turn(1, 0, 0, 0)
        grip.settled(0.0, 0.0, 0.0)
        assert grip.torque == pytest.approx(torque_nm)


def test_a_released_torque_falls_linearly_to_zero() -> None:
    grip = Grip(UP, STICK, RenderSpec(ramp_s=0.02))
    grip.settled(0.0, 0.0, 0.0)
    sizes = [float(np.linalg.norm(grip.torque))]
    for _ in range(25):
        grip.release()
        sizes.append(float(np.linalg.norm(grip.torque)))
    assert sizes[10] == pytest.approx(sizes[0] / 2, rel=1e-6) and sizes[-1] == 0
    assert (np.diff(sizes) <= 0).all()


odd_numbers = st.sampled_from([np.nan, np.inf, -np.inf, 1e300, 0.0])
quaternions = (
    st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1).map(lambda q: unit(*q))
)
turns = quaternions.map(tuple) | st.tuples(*[odd_numbers] * 4)
offsets = st.floats(-0.08, 0.08) | odd_numbers
moves = st.tuples(
    st.booleans(), offsets, offsets, offsets, turns, st.sampled_from([0.001, 0.0, 0.5, 1e-18, np.nan])
)

WILD = Grip(lambda p: 900.0 * p[..., ::-1] * np.array([1.0, -1.0, 3.0]), Tool.sphere(0.03, 40))


@given(
    st.lists(moves, min_size=3, max_size=40),
    st.sampled_from([None, 0.001, 0.05]),
    st.sampled_from([None, 0.01, 1e5]),
    st.sampled_from([1.0, 1e-300, 1e300]),
)
def test_limits_of_torque_hold_exactly_for_the_output(
    steps: list[tuple[object, ...]], peak: float | None, slew: float | None, scale: float
) -> None:
    WILD.restart(RenderSpec(peak_nm=peak, slew_nm_per_s=slew, scale=scale))
    peak_nm, slew_nm_s = (
        WILD.value("settings.torque_limits.peak"),
        WILD.value("settings.torque_limits.slew_per_s"),
    )
    before = np.zeros(3)
    for is_there, x, y, z, turn, dt in steps:
        WILD.turn(*turn)  # type: ignore[misc]
        WILD.tick(x, y, z, dt, bool(is_there))  # type: ignore[arg-type]
        torque = WILD.torque
        assert np.isfinite(torque).all() and np.linalg.norm(torque) <= peak_nm
        allowed = slew_nm_s * dt if np.isfinite(dt) and dt > 0 else 0.0  # type: ignore[operator]
        assert np.linalg.norm(torque - before) <= allowed * (1 + 1e-15)
        before = torque
    for _ in range(5000):
        WILD.release()
        torque = WILD.torque
        assert np.linalg.norm(torque - before) <= slew_nm_s * 0.001 and np.linalg.norm(
            torque
        ) <= np.linalg.norm(before)
        before = torque
        if not torque.any():
            break
    if slew != 0.01:
        assert not before.any()


def test_a_long_torque_falls_to_the_continuous_limit() -> None:
    grip = Grip(constant(0.0, 0.0, 2.0), STICK, RenderSpec(continuous_nm=0.05, thermal_s=0.2))
    sizes = []
    for _ in range(1500):
        grip.tick(0.0, 0.0, 0.0)
        sizes.append(float(np.linalg.norm(grip.torque)))
    assert max(sizes) == pytest.approx(SIGMA.torque_max_nm, rel=1e-6)
    assert sizes[-1] == pytest.approx(0.05, rel=1e-2) and grip.value("state.torque.heat") <= 0.05**2
