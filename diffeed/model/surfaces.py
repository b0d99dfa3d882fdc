"""What contact and friction are like, body by body."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.input.packing import stacked
from diffeed.input.parts import Scene
from diffeed.pair.law import NEWTON, Surface


def surface_of(scene: Scene, parts: list[tuple[str, Any]]) -> Surface:
    """Of bodies, each with its own friction and the numbers of its contact set."""
    once = {id(part): part for _, part in parts}  # a guide owns its tips too
    place = {key: k for k, key in enumerate(once)}
    friction = stacked([part.friction for part in once.values()])[np.array([place[id(p)] for _, p in parts], dtype=int)]
    return _surface_of_sets(scene, [p.contact for _, p in parts], friction)


def pair_surface(scene: Scene, rollers: list[tuple[str, Any]], pairs: tuple[tuple[int, int], ...]) -> Surface:
    """Two rollers use the smaller of their frictions (0 of one whose set has none) and the contact set of the first movable
    one.

    They never stick: each turns freely or drives the other, and what they carry tangentially is a bearing's drag.
    """
    slick = np.array([scene.contacts[r.contact].friction_law == "none" for _, r in rollers], dtype=bool)
    each, index = stacked([r.friction for _, r in rollers]), np.array(pairs, dtype=int).reshape(-1, 2)
    each = jnp.where(slick, 0.0, each) if slick.any() else each
    friction = jnp.minimum(each[index[:, 0]], each[index[:, 1]])
    return _surface_of_sets(scene, [rollers[i][1].contact for i, _ in pairs], friction, can_stick=False)


def any_sticks(scene: Scene, parts: list[tuple[str, Any]]) -> bool:
    """Whether friction sticks anywhere among these."""
    return any(scene.contacts[p.contact].friction_law == "stick" for _, p in parts)


def _surface_of_sets(scene: Scene, sets: list[str], friction: Array, can_stick: bool = True) -> Surface:
    known = sorted(scene.contacts)
    index = np.array([known.index(s) for s in sets], dtype=int)
    contacts = [scene.contacts[name] for name in known]

    def per_body(values: list[Any]) -> Array:
        return stacked(values)[index]

    used = [contacts[k] for k in sorted(set(index.tolist()))]
    excess = None
    if any(c.static_ratio is not None for c in used):
        excess = per_body([0.0 if c.static_ratio is None else c.static_ratio - 1.0 for c in contacts])
    tanh, stick = (np.array([contacts[k].friction_law == law for k in index], dtype=bool) for law in ("tanh", "stick"))
    sticks = can_stick and bool(stick.any())
    slick = np.array([contacts[k].friction_law == "none" for k in index], dtype=bool)
    damped = np.array([c.damped for c in contacts])
    damping = NEWTON * per_body([c.damping for c in contacts])
    return Surface(
        friction=None if len(index) and slick.all() else jnp.where(slick, 0.0, friction) if slick.any() else friction,
        stiffness=NEWTON * per_body([c.stiffness for c in contacts]),
        exponent=per_body([c.exponent for c in contacts]),
        damping=damping if damped.all() else jnp.where(damped[index], damping, 0.0) if damped[index].any() else None,
        damping_exponent=per_body([c.damping_exponent for c in contacts]),
        smoothing=per_body([c.smoothing for c in contacts]),
        stick_speed=per_body([c.stick_speed for c in contacts]),
        static_excess=excess,
        transition_speed=per_body([c.transition_speed for c in contacts]),
        tanh=jnp.asarray(tanh) if tanh.any() else None,
        stick=jnp.asarray(stick) if sticks else None,
        stick_displacement=per_body([c.stick_displacement for c in contacts]) if sticks else None,
    )
