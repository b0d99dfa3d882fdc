"""Sheets as bars and joints, and what holds and pushes them."""

from collections.abc import Callable

import jax.numpy as jnp
from jax import Array

from diffeed.input.parts import Clamp, Scene, Sheet
from diffeed.model.arrays import Bars, Hold, Push
from diffeed.model.layout import Layout
from diffeed.model.movements import path_of
from diffeed.pair.law import NEWTON


def joint_stiffness(sheet: Sheet) -> Array:
    """k = E t^3 w/(12 Ls) (source paper, eq. 4, with the width explicit), kg mm2/s2."""
    return NEWTON * sheet.youngs_modulus * sheet.thickness**3 * sheet.width * sheet.bars / (12.0 * sheet.length)


def per_bar(sheets: list[Sheet], layout: Layout, value: Callable[[Sheet], Array]) -> Array:
    """(bars,) of what is the same for all bars of a sheet."""
    return jnp.concatenate([jnp.broadcast_to(value(s), (n,)) for s, n in zip(sheets, layout.bars, strict=True)])


def bars_of(sheets: list[Sheet], layout: Layout) -> Bars:
    """Mass and inertia of a bar: m = rho Ls t w, I = m (t^2 + Ls^2)/12 (source paper, eqs. 1 and 2)."""

    def mass(s: Sheet) -> Array:
        return s.density * s.length * s.thickness * s.width / s.bars

    def inertia(s: Sheet) -> Array:
        return mass(s) * (s.thickness**2 + (s.length / s.bars) ** 2) / 12.0

    def row(value: Callable[[Sheet], Array]) -> Array:
        return per_bar(sheets, layout, value)

    joint = jnp.asarray(~layout.last, jnp.result_type(float))
    return Bars(
        mass=row(mass),
        inertia=row(inertia),
        half_length=row(lambda s: 0.5 * s.length / s.bars),
        half_thickness=row(lambda s: 0.5 * s.thickness),
        friction_factor=row(lambda s: s.friction_factor),
        joint_stiffness=joint * row(joint_stiffness),
        joint_damping=joint * row(lambda s: s.structural_damping * joint_stiffness(s)),
        # Curvature turns left along the travel, and a bar leads the next one: theta_i - theta_(i+1) = curl Ls.
        rest_angle=joint * row(lambda s: s.curl * s.length / s.bars),
    )


def hold_of(scene: Scene, layout: Layout, clamp: Clamp) -> Hold:
    """A clamp holds where the scene's own records put the sheet, and by its displacement beside it."""
    whole = clamp.kind == "bar"
    bar, end = layout.bar(clamp.sheet, clamp.at, whole)
    sheet = scene.sheets[clamp.sheet]
    local = bar - layout.starts[layout.names.index(clamp.sheet)]
    headings = initial_headings(sheet)
    nodes = initial_nodes(sheet, headings)
    at = 0.5 * (nodes[local] + nodes[local + 1]) if whole else nodes[local + (0 if end > 0 else 1)]
    rows = tuple(d for d in ("x", "y") if clamp.free != d) + (("heading",) if whole else ())
    angle = headings[local] + jnp.deg2rad(clamp.rotation)
    if clamp.kind == "wall" and sheet.headings is None:  # half a bar of curl from the wall to the middle of the bar
        angle = angle - end * 0.5 * sheet.curl * sheet.length / sheet.bars
    return Hold(
        x=at[0] + clamp.displacement[0],
        y=at[1] + clamp.displacement[1],
        angle=angle,
        path=None if clamp.motion is None else path_of(clamp.motion),
        bar=bar,
        end=end,
        rows=rows,
        wall=clamp.kind == "wall",
    )


def push_of(scene: Scene, layout: Layout, name: str) -> Push:
    """A dead load by its name."""
    load = scene.loads[name]
    bar, end = layout.bar(load.sheet, load.at)
    force, moment = NEWTON * load.force, NEWTON * load.moment
    return Push(x=force[0], y=force[1], moment=moment, bar=bar, end=end)


def initial_headings(sheet: Sheet) -> Array:
    """(bars,) rad."""
    given = sheet.heading if sheet.headings is None else sheet.headings
    return jnp.deg2rad(jnp.broadcast_to(given, (sheet.bars,)))


def initial_nodes(sheet: Sheet, headings: Array) -> Array:
    """(bars + 1, 2) mm, node 0 the leading edge."""
    along = jnp.stack([jnp.cos(headings), jnp.sin(headings)], axis=1) * (sheet.length / sheet.bars)
    return sheet.lead[None, :] - jnp.concatenate([jnp.zeros((1, 2)), jnp.cumsum(along, axis=0)])
