"""What a run owes: momentum, energy and powers of every frame, from the package's own look at its states."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from diffeed.chain.state import State
from diffeed.contact.kept import keep_all
from diffeed.forces.energy import Powers, energies, powers
from diffeed.input.parts import Scene
from diffeed.model.arrays import Model
from diffeed.model.build import build
from diffeed.readings.snapshot import look


class Ledger(NamedTuple):
    """(frames,) each unless said otherwise; kg, mm, s for momenta, N mm for energies."""

    momentum: Any  # (frames, 2) of the sheets
    spin: Any  # angular momentum of the sheets about the origin
    push: Any  # (frames, 2) sum of contact forces on sheets, kg mm/s2
    weight: Any  # (frames, 2) of the sheets
    energy: Any
    powers: Powers
    travelling: Any  # (frames, movable) momentum of sprung rollers along their way


def _entry(model: Model, state: State) -> Ledger:
    at, _, touching = look(model, state)
    bars = model.bars
    push = jnp.zeros(2)
    if touching.sheets is not None:
        p = touching.sheets
        f, t = p.touch.force, -p.touch.friction
        push = jnp.stack([jnp.sum(f * p.nx - t * p.ny), jnp.sum(f * p.ny + t * p.nx)])
    return Ledger(
        momentum=jnp.stack([jnp.sum(bars.mass * at.vx), jnp.sum(bars.mass * at.vy)]),
        spin=jnp.sum(bars.mass * (at.x * at.vy - at.y * at.vx) + bars.inertia * at.w),
        push=push,
        weight=jnp.sum(bars.mass) * model.gravity,
        energy=sum(energies(model, state, touching, keep_all(model)), jnp.zeros(())),
        powers=powers(model, state, touching, keep_all(model)),
        travelling=model.rollers.mass * state.travel_rate,
    )


@jax.jit
def ledger(scene: Scene, states: State) -> Ledger:
    """Of all frames of a run."""
    model = build(scene)
    return jax.vmap(functools.partial(_entry, model))(states)


def input_power(book: Ledger) -> np.ndarray:
    """N mm/s: what drives put in less all losses."""
    p = book.powers
    return np.asarray(p.drives - p.friction - p.contact - p.joints - p.rollers)


def integral(values: Any, time: Any) -> np.ndarray:
    """Running integral by Simpson's rule at every second frame, (frames // 2 + 1, ...)."""
    y, h = np.asarray(values), float(time[1] - time[0])
    pieces = h / 3.0 * (y[:-2:2] + 4.0 * y[1:-1:2] + y[2::2])
    return np.concatenate([np.zeros_like(y[:1]), np.cumsum(pieces, axis=0)])
