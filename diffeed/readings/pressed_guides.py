"""How hard sheets press on guides, in every step: what wears a guide and marks a sheet."""

from typing import Any

import jax.numpy as jnp
from jax import Array

from diffeed.base.records import number, record
from diffeed.base.smooth import divide
from diffeed.chain.state import State
from diffeed.contact.kept import Kept, by_body, keep_all
from diffeed.forces.contacts import Contacts
from diffeed.input.parts import Scene
from diffeed.model.arrays import Model
from diffeed.pair.law import NEWTON
from diffeed.readings.snapshot import by_guide, guide_names
from diffeed.readings.trajectory import Parts


@record
class GuideSums:
    """Running sums per guide, (guides,) in sorted order."""

    time: Any
    force: Any
    force_peak: Any


@record
class GuideStats:
    """Per guide over the time in which a sheet touched it; zeros if none ever did."""

    contact_time: Any = number(unit="s", doc="time in contact")
    force_mean: Any = number(unit="N", doc="mean normal force of all sheets together")
    force_peak: Any = number(unit="N", doc="largest normal force")


def on_guides(model: Model, touching: Contacts, kept: Kept) -> Array:
    """(guides,) N, the normal forces on each, in sorted order, from the kept pairs."""
    if touching.sheets is None or not guide_names(model):
        return jnp.zeros((len(guide_names(model)),))
    return by_guide(model, by_body(model, kept, touching.sheets.touch.force[None])[0]) / NEWTON


def start(model: Model, scene: Scene, state: State) -> GuideSums:
    zero = jnp.zeros((len(guide_names(model)),))
    return GuideSums(time=zero, force=zero, force_peak=zero)


def update(model: Model, scene: Scene, sums: GuideSums, seen: Any) -> GuideSums:
    return _add(model, sums, seen.touching, seen.kept, seen.share)


def _add(model: Model, sums: GuideSums, touching: Contacts, kept: Kept, share: Array) -> GuideSums:
    force = on_guides(model, touching, kept)
    return GuideSums(
        time=sums.time + jnp.where(force > 0, share, 0.0),
        force=sums.force + share * force,
        force_peak=jnp.maximum(sums.force_peak, force),
    )


def close(model: Model, scene: Scene, sums: GuideSums, end: Any) -> Parts[GuideStats]:
    done = _add(model, sums, end.touching, keep_all(model), end.share)
    block = GuideStats(contact_time=done.time, force_mean=divide(done.force, done.time), force_peak=done.force_peak)
    return Parts(block=block, names=guide_names(model))
