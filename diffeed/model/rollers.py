"""Rollers, grouped by what moves them."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.input.packing import stacked
from diffeed.input.parts import FixedRoller, MovableRoller, Profile, Scene
from diffeed.model.arrays import Drives, Rollers
from diffeed.model.rows import columns, named, padded
from diffeed.pair.law import NEWTON


def is_driven(roller: FixedRoller | MovableRoller) -> bool:
    """Whether its shaft is prescribed; else it turns freely."""
    return roller.angular_speed is not None or roller.surface_speed is not None


def rollers_of(scene: Scene) -> tuple[Rollers, list[tuple[str, Any]]]:
    """All rollers in the model's order, and the part behind each."""
    movable, fixed = named(scene.rollers, MovableRoller), named(scene.rollers, FixedRoller)
    groups = [
        [p for p in movable if is_driven(p[1])],
        [p for p in movable if not is_driven(p[1])],
        [p for p in fixed if not is_driven(p[1])],
        [p for p in fixed if is_driven(p[1])],
    ]
    parts = [p for group in groups for p in group]
    moving = [p[1] for p in groups[0] + groups[1]]
    free = [p[1] for p in groups[1] + groups[2]]
    (x, y), ways = columns([r.center for _, r in parts]), columns([r.direction for r in moving])
    long = jnp.sqrt(ways[0] ** 2 + ways[1] ** 2)
    radius = stacked([r.radius for _, r in parts])
    low = [-jnp.inf if r.travel_min is None else r.travel_min for r in moving]
    high = [jnp.inf if r.travel_max is None else r.travel_max for r in moving]
    rollers = Rollers(
        x=x,
        y=y,
        radius=radius,
        dir_x=ways[0] / long,
        dir_y=ways[1] / long,
        mass=stacked([r.mass for r in moving]),
        spring=NEWTON * stacked([r.spring for r in moving]),
        preload=NEWTON * stacked([r.preload for r in moving]),
        damper=NEWTON * stacked([r.damper for r in moving]),
        stop_low=stacked(low),
        stop_high=stacked(high),
        stop_stiffness=NEWTON * stacked([r.stop_stiffness for r in moving]),
        inertia=stacked([r.inertia for r in free]),
        drag=NEWTON * stacked([r.bearing_drag for r in free]),
        travel=stacked([r.travel for r in moving]),
        spin=stacked([r.spin for r in free]),
        drives=(
            _drives([r for _, r in groups[0]], radius[: len(groups[0])]),
            _drives([r for _, r in groups[3]], radius[len(parts) - len(groups[3]) :]),
        ),
        names=tuple(name for name, _ in parts),
        counts=(len(groups[0]), len(groups[1]), len(groups[2]), len(groups[3])),
    )
    return rollers, parts


def _drives(rollers: list[Any], radius: Array) -> Drives:
    """Spins of driven rollers; a surface speed is divided by the radius. Shorter profiles repeat their last point."""
    given = [r.angular_speed if r.angular_speed is not None else r.surface_speed for r in rollers]
    of_surface = np.array([r.angular_speed is None for r in rollers], dtype=bool)
    if not any(isinstance(g, Profile) for g in given):
        times, values = np.zeros((len(rollers), 1)), stacked(given)[:, None]
    else:
        both = [(g.times, g.values) if isinstance(g, Profile) else (jnp.zeros((1,)), stacked([g])) for g in given]
        points = max(t.shape[0] for t, _ in both)
        times, values = (jnp.stack([padded(p[k], points) for p in both]) for k in (0, 1))
    return Drives(
        times=jnp.asarray(times, values.dtype),
        values=jnp.where(of_surface[:, None], values / radius[:, None], values),
    )
