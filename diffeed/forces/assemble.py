"""`assemble`: the forces of all causes, summed into the system of a step.

Implicit terms: with step h, a contact of force F, stiffness K and damping C adds (h^2 K + h C) g_n g_n' to the matrix
and F - h K v_n to the force; friction adds h (mu F phi/v_t) g_t g_t' and its force, sticking friction its own secant. With
`implicit=False` all h-terms are left out: the plain equations of motion.
"""

import jax

from diffeed.chain.kinematics import Pose, pose
from diffeed.chain.state import State
from diffeed.chain.system import System
from diffeed.contact.bodies import bodies
from diffeed.contact.kept import Kept
from diffeed.forces.clamps import clamps, walls
from diffeed.forces.contacts import Contacts, contacts, pair_terms
from diffeed.forces.loads import pushes
from diffeed.forces.rollers import border
from diffeed.forces.sheet import coupling, inertia, joints, tension, weight
from diffeed.forces.terms import Step, summed
from diffeed.model.arrays import Model


def assemble(model: Model, state: State, step: Step, kept: Kept) -> tuple[System, Pose, Contacts]:
    """The linear system of a step from `state`, with the pose and the contacts that it saw."""
    with jax.named_scope("pose"):
        at = pose(model, state)
        world = bodies(model, state, state.time, state.time + step.h if step.implicit else state.time)
    with jax.named_scope("contact"):
        touching = contacts(model, at, world, kept, state.grip, step.h if step.implicit else 0.0)
    return system_of(model, state, step, kept, at, touching), at, touching


def system_of(model: Model, state: State, step: Step, kept: Kept, at: Pose, touching: Contacts) -> System:
    """The same from the pose and the contacts of the state."""
    with jax.named_scope("forces"):
        terms = [inertia(model), weight(model), joints(model, state, step), tension(state, step)]
        terms += [pushes(model, at), walls(model, state, step)]
        terms += [pair_terms(model, touching.sheets, at, step, kept)] if touching.sheets is not None else []
        half = model.bars.half_length
        centripetal = half * state.rate * state.rate
        return System(
            bars=summed([t for t in terms if t is not None]),
            coupling=coupling(model, step),
            lever_x=half * at.s,
            lever_y=-half * at.c,
            bias_x=centripetal * at.c,
            bias_y=centripetal * at.s,
            border=border(model, state, touching, step, kept) if model.n_border else None,
            clamps=clamps(model, state, at, step) if model.holds else None,
        )
