"""The damper of a proxy: hands come to rest beside edges, and feel it nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
from heap_makers import behind_surface, heap_of_boxes
from proxy_makers import DT_S, Held, Vector, field_of
from seam_makers import DAMPING_N_S_PER_M, HAND_KG, PARTS, SPRING_N_PER_M

from touchfield.medium import ForceField
from touchfield.medium.grid import Grid
from touchfield.sources.shapes.shapes import Box

MOST_N_S_PER_M, HALF_M_S, SHARE = 8.0, 0.05, 0.1
"""Of the damper: at most, on the device; the speed at which it is half as large; of the force of contact."""
MEAN_S, GO_S = 0.2, 0.05
"""Time constants of the mean velocity, and in which the damper goes."""
PLATE = Box((0.0, 0.0, 0.0), (0.03, 0.02, 0.001))


def on_a_spring(rendered: Held, start_m: Vector, goal_m: Vector, ticks: int) -> Vector:
    """Return the positions of a hand on a spring, [ticks, 3]."""
    x, v, rows = start_m.copy(), np.zeros(3), np.empty((ticks, 3))
    dt_s = DT_S / PARTS
    for n in range(ticks):
        force = rendered.tick(x)
        for _ in range(PARTS):
            v += dt_s / HAND_KG * (force + SPRING_N_PER_M * (goal_m - x) - DAMPING_N_S_PER_M * v)
            x += dt_s * v
        rows[n] = x
    return rows


def test_hands_on_springs_come_to_rest_beside_edges() -> None:
    """Without the damper, each of these swung for ever, by 0.2 to 1.3 mm."""
    field = heap_of_boxes()
    starts_m, goals_m = behind_surface(field, 60)
    swings_m = []
    for hand in (22, 25, 30, 31, 33, 48, 57, 58):
        positions = on_a_spring(Held(field), starts_m[hand], goals_m[hand], 4000)
        swings_m.append(np.ptp(positions[3600:], axis=0).max() / 2)
    assert max(swings_m) < 0.02e-3


def turning_floor(turn_n_per_m: float) -> ForceField:
    """Return a floor at z = 0 whose force also drives a hand round the z axis: it has no potential."""
    grid = Grid((48, 48, 48), (0.001,) * 3, (-0.0235,) * 3)
    p = grid.to_m(np.moveaxis(np.indices(grid.shape), 0, -1))
    force = np.stack([-turn_n_per_m * p[..., 1], turn_n_per_m * p[..., 0], -500.0 * p[..., 2]], axis=-1)
    return ForceField.from_dense(grid, np.where(p[..., 2:] < 0.0, force, 0.0).astype(np.float32))


def test_a_hand_comes_to_rest_where_the_stored_force_drives_it_round() -> None:
    """The field alone makes it go round by millimetres."""
    extents_m = {}
    for is_proxy in (False, True):
        rendered = Held(turning_floor(90.0), is_proxy)
        positions = on_a_spring(rendered, np.array([2e-5, 0.0, 0.0]), np.array([0.0, 0.0, -0.012]), 3000)
        extents_m[is_proxy] = np.ptp(positions[2700:], axis=0).max()
    assert extents_m[False] > 5e-3 and extents_m[True] < 0.2e-3


def pressed(rest: int = 3000) -> tuple[Held, Vector]:
    """Return a hand that rests deep in a thin plate, where the proxy adds force, and its position."""
    rendered, hand = Held(field_of(PLATE)), np.array([0.004, -0.003, -0.001])
    for z in np.linspace(0.006, hand[2], 60):
        rendered.tick(np.array([hand[0], hand[1], z]))
    for _ in range(rest):
        rendered.tick(hand)
    return rendered, hand


def damper_n(rendered: Held, hand: Vector, step_m: Vector) -> Vector:
    """Return what the damper adds in a tick in which the hand moves, newtons, if all of it acts."""
    proxy, before = rendered.memory.receiver["state"]["proxy"], rendered.memory.bytes.copy()
    found = []
    for acting in (0.0, 1.0):
        rendered.memory.bytes[:] = before
        proxy["swing"]["damping"] = acting
        found.append(rendered.tick(hand + step_m))
    rendered.memory.bytes[:] = before
    return found[1] - found[0]


@pytest.mark.parametrize(("scale", "force_scale"), [(1.0, 1.0), (3.0, 1.0), (1.0, 0.5)])
def test_the_damper_is_one_of_the_device(scale: float, force_scale: float) -> None:
    """Of B v / (1 + (v / 50 mm/s)^2) against the motion, and a tenth of the force, whatever the scale is."""
    rendered, hand = pressed()
    settings = rendered.memory.receiver["settings"]
    settings["scale"], settings["force_scale"], settings["velocity_cutoff_rad_s"] = scale, force_scale, 1e9
    hand = hand / scale
    for _ in range(3000):
        force = rendered.tick(hand)
    limited = 0
    for step_m in ([1e-6, 0.0, 0.0], [-4e-6, 3e-6, 0.0], [0.0, 5e-5, 0.0]):
        step = np.array(step_m)
        velocity = np.exp(-DT_S / MEAN_S) * step / DT_S  # beside its mean, of which this tick is a part
        speed = float(np.linalg.norm(velocity))
        size = np.exp(-DT_S / GO_S) * MOST_N_S_PER_M * speed / (1 + (speed / HALF_M_S) ** 2)
        limit = SHARE * float(np.linalg.norm(force))
        limited += size > limit
        assert damper_n(rendered, hand, step) == pytest.approx(
            -min(size, limit) * velocity / speed, rel=0.02, abs=1e-9
        )
    assert limited


@pytest.mark.parametrize("thickness_m", [0.002, 0.005])
def test_a_thin_wall_that_is_pressed_and_let_go_is_hardly_damped(thickness_m: float) -> None:
    """It gives back what it took, although what the proxy adds to it rises and falls steeply."""
    plate = Box((0.0, 0.0, 0.0), (0.03, 0.02, thickness_m / 2))
    rendered, damping, added = Held(field_of(plate)), [], []
    for z in np.concatenate([np.linspace(0.006, -0.001, 300), np.linspace(-0.001, 0.006, 300)]):
        rendered.tick(np.array([0.004, -0.003, z]))
        damping.append(rendered.value("state.proxy.swing.damping"))
        added.append(rendered.value("state.proxy.force_n") - rendered.value("state.proxy.stored_n"))
    assert np.linalg.norm(added, axis=1).max() > 0.3 and max(damping) < 0.2


def test_a_thin_wall_without_friction_has_no_drag() -> None:
    """A hand slides where half of the force is the proxy's."""
    plate = Box((0.0, 0.0, 0.0), (0.03, 0.02, 0.0025))
    rendered, forces = Held(field_of(plate)), []
    for z in np.linspace(0.009, 0.00007, 300):
        rendered.tick(np.array([-0.02, 0.0, z]))
    for x in np.linspace(-0.02, 0.01, 1000):
        forces.append(rendered.tick(np.array([x, 0.0, 0.00007])))
        added = rendered.value("state.proxy.force_n") - rendered.value("state.proxy.stored_n")
        assert np.linalg.norm(added) > 0.2
    assert np.abs(forces)[:, :2].max() < 1e-3


def test_the_damper_ends_with_the_contact() -> None:
    """A hand that leaves feels at most a tenth of the force of contact of it, and none in free space."""
    (damped, hand), (free, _) = pressed(), pressed()
    for z in np.linspace(hand[2], 0.006, 200):
        damped.memory.receiver["state"]["proxy"]["swing"]["damping"] = 1.0
        at = np.array([hand[0], hand[1], z])
        with_damper, without = damped.tick(at), free.tick(at)
        contact_n = np.linalg.norm(without)
        assert np.linalg.norm(with_damper - without) <= SHARE * contact_n * 1.001 + 1e-12
    assert contact_n == 0.0
