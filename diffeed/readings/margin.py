"""How far a run is from a jam: smooth, signed, without unit. Above 0: passes with that much to spare; below 0: jams.

Each part of the margin is 1 - load/limit, so that 0 is the limit and 1 is no load at all. `measures.verdict` is the hard
judgement of the same run.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.base.names import known_name
from diffeed.base.products import product
from diffeed.base.smooth import polar, ramp, soft_max
from diffeed.input.packing import jit_of_scene, stacked
from diffeed.input.parts import Scene, normalise
from diffeed.model.build import build
from diffeed.readings.frames import Approach, approach
from diffeed.readings.trajectory import Trajectory

NEEDS = ("feed", "spans")
PARTS = ("progress", "buckling", "fold", "attack", "gap")
SOFTNESS = 0.05
"""Width over which the smallest part is smoothed."""
ENOUGH = 0.5
"""Fed per commanded distance that counts as feeding, for a scene without a goal."""
HELD = 4.0
"""Euler load of a span whose ends are held straight over that of hinged ends: a nip is nearer to the former."""
FOLDED = np.deg2rad(150.0)
"""Turn over three joints that counts as folded back."""
NEAR = 1.0
"""mm: a head nearer than this to a guide is about to meet it."""


def jam_margins(scene: Scene, trajectory: Trajectory, sheet: str | None = None) -> dict[str, Array]:
    """The parts of the margin of one sheet (the first if not named). Needs observe=("feed", "spans").

    progress: fed distance over the distance that brings the tail to the scene's goal (straight from lead to goal; from the
    tail if the sheet lies in the gate at the start, or runs tail first), less 1; without a goal, over half the commanded
    distance. buckling: compression between nips against the Euler load of a free span with held ends (guides that hold the sheet
    are not seen: in a narrow channel leave this part out). fold: turn over three joints against 150 degrees. attack: angle at
    which the head meets a guide against the angle at which friction holds it fast, 90 degrees less the friction angle. gap: depth
    to which the head is pressed into a guide against half a millimetre.
    """
    scene = normalise(scene)
    for name in NEEDS:
        if name not in trajectory.observed:
            raise ValueError(f'jam_margins needs simulate(..., observe={NEEDS}), but "{name}" was not observed')
    name = min(scene.sheets) if sheet is None else sheet
    known_name("sheet", name, scene.sheets)
    model = jax.eval_shape(build, scene)  # names and counts only
    near = approach(scene, trajectory.states) if model.guides.names else None
    found: dict[str, Array] = _parts(scene, trajectory, near, name)
    return {part: found[part] for part in PARTS if part in found}


def jam_margin(scene: Scene, trajectory: Trajectory, sheet: str | None = None) -> Array:
    """The smallest part of `jam_margins`, smoothed: never above it, at most SOFTNESS log(parts) below."""
    parts = jnp.stack(list(jam_margins(scene, trajectory, sheet).values()))
    return -soft_max(-parts, 0, SOFTNESS)


@jit_of_scene(static_argnames=("name",))
def _parts(scene: Scene, trajectory: Trajectory, near: Approach | None, name: str) -> dict[str, Array]:
    parts = {
        "progress": _progress(scene, trajectory, name),
        "buckling": 1.0 - trajectory.observed["spans"][name].buckling / HELD,
        "fold": _fold(trajectory, name),
    }
    return parts if near is None else parts | _head(scene, trajectory, near, name)


def _progress(scene: Scene, trajectory: Trajectory, name: str) -> Array:
    feed = trajectory.observed["feed"][name]
    if not scene.goal:
        forward = feed.fed * jnp.sign(feed.commanded)  # fed tail first, both are negative
        return forward / jnp.maximum(jnp.abs(feed.commanded), 1e-6) / ENOUGH - 1.0
    goal, (lead, tail) = scene.sensors[scene.goal], trajectory.sheets[name].nodes[0, (0, -1), :]
    way = goal.direction / jnp.sqrt(jnp.sum(goal.direction**2))
    ahead, left = product(lead - goal.position, way), product(goal.position - tail, way)
    beside = jnp.abs(product(lead - goal.position, jnp.stack([-way[1], way[0]])))
    through = (ahead >= 0.0) & (left > 0.0) & (beside < goal.range)  # it lies in the gate at the start
    from_lead = scene.sheets[name].length + polar(*(goal.position - lead))[0]
    tail_first = feed.commanded < 0.0
    from_tail = jnp.where(through, left, polar(*(goal.position - tail))[0])
    needed = jnp.where(through | tail_first, from_tail, from_lead)
    return jnp.minimum(jnp.where(tail_first, -feed.fed, feed.fed) / needed - 1.0, 1.0)


def _fold(trajectory: Trajectory, name: str) -> Array:
    headings = trajectory.sheets[name].headings
    span = min(3, headings.shape[1] - 1)
    if span < 1:
        return jnp.ones(())
    turns = jnp.abs(headings[:, span:] - headings[:, :-span]) / FOLDED
    return 1.0 - soft_max(turns.ravel(), 0, 0.01)


def _head(scene: Scene, trajectory: Trajectory, near: Approach, name: str) -> dict[str, Array]:
    """Attack and gap of the head at line and arc guides, over frames."""
    model = build(scene)
    k = model.layout.names.index(name)
    feature, first = model.layout.starts[k] + k, len(model.circle_names)
    gap, into, weight = (v[:, first:, feature] for v in near)  # (frames, guides)
    gap = jnp.where(weight > 0, gap, jnp.inf)
    guides = [scene.guides[n] for n in model.guides.names]
    slick = np.array([scene.contacts[g.contact].friction_law == "none" for g in guides])
    friction = jnp.where(slick, 0.0, stacked([g.friction for g in guides]))
    holds = 0.5 * jnp.pi - jnp.arctan(friction * scene.sheets[name].friction_factor)
    steep = jnp.arcsin(jnp.clip(into, -0.999, 0.999)) / holds[None]
    finite = jnp.where(jnp.isfinite(gap), gap, NEAR)
    close = jnp.clip(1.0 - finite / NEAR, 0.0, 1.0)
    pressed = ramp(-finite, jnp.asarray(0.01))[0] / 0.5
    # Only a head that meets a guide, not one that is held against it by the nip behind: its own pair near the face.
    return {
        "attack": 1.0 - soft_max((close * steep).ravel(), 0, 0.01),
        "gap": 1.0 - soft_max(pressed.ravel(), 0, 0.01),
    }
