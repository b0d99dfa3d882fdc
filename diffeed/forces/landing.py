"""Friction of a landing: by the normal force that a step lets through, where that is another than the force it began with.

Friction is mu times the normal force at the start of a step. The step itself feels an implicit one, which is far less where
a sheet lands or bounces within it: friction would then brake many times too much. The impulse of friction must be mu times
that of the normal force (Coulomb), so such a step is solved once more with friction by what the first solution let through.
Where contacts are resolved both forces are alike, and nothing is solved again.
"""

from collections.abc import Sequence

import jax.numpy as jnp
from jax import Array

from diffeed.base.products import product
from diffeed.base.smooth import divide, polar
from diffeed.base.sweeps import sums
from diffeed.chain.state import State, total_per_sheet
from diffeed.chain.system import Solution
from diffeed.contact import gained, stick
from diffeed.contact.features import by_feature
from diffeed.contact.kept import Kept, by_contact
from diffeed.contact.sweep import Pairs
from diffeed.forces.contacts import Contacts, felt
from diffeed.forces.terms import Step
from diffeed.model.arrays import Model
from diffeed.pair.law import with_friction

UNNOTICED, PLAIN = 0.01, 0.03
"""Of all friction that a sheet may have and of its weight: by how much friction may be wrong before it is found again, and from
where on by the new force alone. In between by a part of it, so that a run has no jump."""


def applied(model: Model, pairs: Pairs, a: Solution, step: Step, kept: Kept) -> Array:
    """Of each pair, kg mm/s2: the normal force that an implicit step with the accelerations `a` applies. Below 0 where it pulls
    back what it has pushed away too far."""
    pair = felt(pairs, step)
    return pair.f_n - pair.a_n * gained.apart(model, pairs, a, kept)


def share(model: Model, pairs: Pairs, normal: Array, kept: Kept) -> Array:
    """0 to 1: how far friction is to go by the `normal` forces that the step applies.

    By how wrong that of any sheet is in all. A contact's part in that is weighed by how unlike the forces are: that of a resolved
    one is a little more in one step and as much less in another.
    """
    force, either = pairs.touch.force, pairs.touch.force + jnp.abs(normal)
    factor = jnp.abs(divide(pairs.touch.friction, force))
    wrong, most = _by_sheet(model, kept, (factor * divide((force - normal) ** 2, either), factor * either))
    weight = total_per_sheet(model.layout, model.bars.mass) * polar(model.gravity[0], model.gravity[1])[0]
    part = jnp.clip((jnp.max(divide(wrong, most + weight)) - UNNOTICED) / (PLAIN - UNNOTICED), 0.0, 1.0)
    return part * part * (3.0 - 2.0 * part)


def _by_sheet(model: Model, kept: Kept, values: Sequence[Array]) -> Array:
    """(bodies, features) or (pairs,) each -> (values, sheets)."""
    if len(model.layout.names) == 1:
        return jnp.stack(sums(*values))[:, None]
    of_features = by_feature(model, values, kept.pairs)
    return product(of_features, jnp.asarray(model.layout.sheet_of_feature, of_features.dtype))


def let_through(model: Model, normal: Array, kept: Kept) -> Array:
    """Of each pair, kg mm/s2, >= 0: its part of what a sheet and a body press on each other with in all. Where bars rock, a step
    pushes some and pulls others back; what counts for friction is what is left of both."""
    pushed = jnp.maximum(normal, 0.0)
    left, pushes = by_contact(model, kept, jnp.stack([normal, pushed]))
    return pushed * jnp.maximum(divide(left, pushes), 0.0)


def pressed_by(model: Model, state: State, touching: Contacts, force: Array, step: Step, kept: Kept) -> Contacts:
    """The same contacts with the friction of another normal force, (pairs)."""
    pairs = touching.sheets
    assert pairs is not None, "only where there is friction"
    grip, own = stick.of_pairs(model, state.grip, kept, step.h), kept.own.friction_factor
    by = with_friction(kept.surface, pairs.touch._replace(force=force), pairs.v_t, own, grip)
    return touching._replace(sheets=pairs._replace(touch=by._replace(force=pairs.touch.force)))
