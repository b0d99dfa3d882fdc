"""State: what the next step needs, nothing more."""

from typing import Any

import jax.numpy as jnp
from jax import Array

from diffeed.base.records import record
from diffeed.input.parts import Scene, Sheet
from diffeed.model.arrays import Model
from diffeed.model.layout import Layout
from diffeed.model.sheets import initial_headings, initial_nodes


@record
class State:
    """Mass centres and absolute headings (they never wrap), rollers, and the rates of both.

    With the mass centre as base, a free sheet keeps its momentum exactly and bars may be numbered from either end.
    """

    time: Any  # s
    x: Any  # (sheets,) mass centre, mm
    y: Any  # (sheets,) mm
    heading: Any  # (bars,) rad
    travel: Any  # (movable,) mm
    angle: Any  # (rollers,) rad
    vx: Any  # (sheets,) mm/s
    vy: Any  # (sheets,) mm/s
    rate: Any  # (bars,) rad/s
    travel_rate: Any  # (movable,) mm/s
    spin: Any  # (free,) rad/s
    stretch: Any  # (bars,) kg mm2/s2: geometric stiffness of last step's joint forces, per heading
    grip: Any = None  # deflections of sticking contacts over stick_displacement (see `diffeed.contact.stick`); None: none sticks


def initial_state(model: Model, scene: Scene) -> State:
    """The state that the records of a normalised scene describe, not settled."""
    sheets = [scene.sheets[name] for name in model.layout.names]
    headings = [initial_headings(s) for s in sheets]
    rates = [jnp.zeros((s.bars,)) if s.rates is None else s.rates for s in sheets]
    nodes = [initial_nodes(s, h) for s, h in zip(sheets, headings, strict=True)]
    centres = jnp.stack([jnp.mean(0.5 * (n[1:] + n[:-1]), axis=0) for n in nodes])
    speeds = jnp.stack([_centre_velocity(s, h, w) for s, h, w in zip(sheets, headings, rates, strict=True)])
    return State(
        time=jnp.zeros(()),
        x=centres[:, 0],
        y=centres[:, 1],
        heading=jnp.concatenate(headings),
        travel=model.rollers.travel,
        angle=jnp.zeros((model.rollers.n,)),
        vx=speeds[:, 0],
        vy=speeds[:, 1],
        rate=jnp.concatenate(rates),
        travel_rate=jnp.zeros((model.rollers.n_movable,)),
        spin=model.rollers.spin,
        stretch=jnp.zeros((model.layout.n_bars,)),
        grip=initial_grip(model),
    )


def initial_grip(model: Model) -> Array | None:
    """No deflection; None where nothing sticks."""
    return jnp.zeros((sum(model.grips),)) if any(model.sticks) else None


def _centre_velocity(sheet: Sheet, headings: Array, rates: Array) -> Array:
    """Velocity of the mass centre, given the leading edge's and the rates."""
    c, s, bar = jnp.cos(headings), jnp.sin(headings), sheet.length / sheet.bars
    lead = sheet.speed * jnp.stack([c[0], s[0]]) if sheet.velocity is None else sheet.velocity
    turning = rates[:, None] * jnp.stack([-s, c], axis=1) * bar
    behind = jnp.cumsum(turning, axis=0) - 0.5 * turning
    return lead - jnp.mean(behind, axis=0)


def total_per_sheet(layout: Layout, values: Array) -> Array:
    """(bars,) -> (sheets,)."""
    return jnp.stack([jnp.sum(values[s]) for s in layout.slices()])


def mean_per_sheet(layout: Layout, values: Array) -> Array:
    """(bars,) -> (sheets,)."""
    return jnp.stack([jnp.mean(values[s]) for s in layout.slices()])


def spread(layout: Layout, values: Array) -> Array:
    """(sheets,) -> (bars,)."""
    if len(layout.bars) == 1:
        return jnp.broadcast_to(values, (layout.n_bars,))
    return values[layout.sheet_of_bar]
