"""Small vibrations about a state: `linearise`."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.core import Tracer

from diffeed.base.products import product
from diffeed.base.records import record, replace, word
from diffeed.base.smooth import divide
from diffeed.chain.state import State
from diffeed.contact import stick
from diffeed.contact.kept import keep_all
from diffeed.input.check_records import checked
from diffeed.input.packing import jit_of_scene
from diffeed.input.parts import Scene
from diffeed.model.arrays import Model
from diffeed.model.build import build
from diffeed.readings.snapshot import look
from diffeed.statics.coordinates import (
    generalised_force,
    held_places,
    mass_matrix,
    positions,
    velocities,
    with_positions,
)
from diffeed.statics.rest import at_rest


@record
class Linearisation:
    """Small motions M q'' + C q' + K q = 0 about a state, in coordinates that satisfy the clamps; (n, n) each.

    Units kg, mm, s, rad. `basis` (coordinates, n) maps back to mass centres, headings, travels and free angles.
    """

    mass: Any  # (n, n) kg, kg mm2
    damping: Any  # (n, n) kg/s, kg mm2/s
    stiffness: Any  # (n, n) kg/s2, kg mm2/s2
    basis: Any  # (coordinates, n)
    sheets: tuple[str, ...] = word(default=(), doc="names of the sheets", type=tuple)

    def modes(self) -> tuple[Any, Any]:
        """Undamped angular frequencies (rad/s, ascending; NaN-free: an unstable mode is negative, one of rounding alone is near
        0) and shapes in columns. Inside a trace too: frequencies that differ from their neighbours have derivatives."""
        if isinstance(self.stiffness, Tracer) or isinstance(self.mass, Tracer):
            return self._traced_modes()
        import scipy.linalg

        square, shapes = scipy.linalg.eigh(np.asarray(self.stiffness), np.asarray(self.mass))
        return np.sign(square) * np.sqrt(np.abs(square)), np.asarray(self.basis) @ shapes

    def _traced_modes(self) -> tuple[Array, Array]:
        """The same by JAX: the mass is taken out by its factor, which leaves a symmetric matrix."""
        root = jnp.linalg.cholesky(self.mass)

        def scaled(matrix: Array) -> Array:
            return lax.linalg.triangular_solve(root, matrix, left_side=True, lower=True)

        square, turned = jnp.linalg.eigh(scaled(scaled(self.stiffness).T))
        shapes = lax.linalg.triangular_solve(root, turned, left_side=True, lower=True, transpose_a=True)
        size = jnp.where(square == 0.0, 1.0, jnp.abs(square))  # the root has no derivative at 0
        return jnp.where(square == 0.0, 0.0, jnp.sign(square) * jnp.sqrt(size)), product(self.basis, shapes)

    def buckling_factors(self, loaded: "Linearisation", share: float = 1.0) -> np.ndarray:
        """Factors on the load at which the stiffness becomes singular, ascending, if `loaded` carries `share` of it and
        this one none. Exact where the stiffness is linear in the load (a straight sheet)."""
        import scipy.linalg

        base = np.asarray(self.stiffness)
        change = (base - np.asarray(loaded.stiffness)) / share
        values = scipy.linalg.eigh(change, base, eigvals_only=True)
        return np.sort(1.0 / values[values > 1e-12 * np.abs(values).max()])


def linearise(scene: Scene, state: State) -> Linearisation:
    """Mass, damping and stiffness at a state, inside a trace too: frequencies have derivatives.

    Stiffness and damping come from the exact derivative of the forces, geometric stiffness of joint, clamp and contact
    forces included, made symmetric: `modes` and `buckling_factors` are those of the conservative part. Friction counts as
    it acts there: regularised, as a damper; sticking, as a tangential spring under the normal force of that state. Raises
    SceneError for numbers that no scene can have.
    """
    return _linearise(checked(scene), state)


@jit_of_scene
def _linearise(scene: Scene, state: State) -> Linearisation:
    model = build(scene)
    state = stick.fitted(model, state)
    q, v = positions(model, state), velocities(state)
    pressed = None if state.grip is None else _pressed(model, state)

    def force(q: Array, v: Array) -> Array:
        moved = with_positions(model, state, q, v)
        return generalised_force(model, replace(moved, grip=_dragged_grip(model, state, q)), keep_all(model), pressed)

    rows = jax.jacfwd(lambda q: held_places(model, with_positions(model, state, q, v))[0])(q)
    load = force(q, v)
    reaction = jnp.linalg.lstsq(rows.T, -load)[0] if rows.shape[0] else jnp.zeros((0,))

    def balance(q: Array) -> Array:
        _, pull = jax.vjp(lambda q: held_places(model, with_positions(model, state, q, v))[0], q)
        return force(q, v) + pull(reaction)[0]

    stiffness, damping = -jax.jacfwd(balance)(q), -jax.jacfwd(lambda v: force(q, v))(v)
    mass = mass_matrix(model, state)
    basis = _null_space(rows)

    def reduced(matrix: Array) -> Array:
        small = product(product(basis.T, matrix), basis)
        return 0.5 * (small + small.T)

    return Linearisation(
        mass=reduced(mass),
        damping=reduced(damping),
        stiffness=reduced(stiffness),
        basis=basis,
        sheets=model.layout.names,
    )


def _dragged_grip(model: Model, state: State, q: Array) -> Array | None:
    """The deflections after a small displacement from a state to q: as after one second at the speed that takes it there."""
    if state.grip is None:
        return None
    start = positions(model, state)
    still = at_rest(model)
    pairs = look(still, with_positions(still, state, start, q - start))[2].sheets
    assert pairs is not None
    return stick.moved(state.grip, *stick.pull(still, pairs, pairs.v_t, keep_all(still)), 1.0)


def _pressed(model: Model, state: State) -> Array:
    """Normal forces of whole contacts at a state. That friction grows with them is no part of a potential: made symmetric,
    it would soften what it does not soften."""
    pairs = look(model, state)[2].sheets
    assert pairs is not None
    return divide(pairs.touch.force, pairs.weight)


def _null_space(rows: Array) -> Array:
    """Orthonormal basis (coordinates, free) of the motions that the clamps allow, by a complete QR factorisation.

    The factorisation has no derivative: the basis is held constant and what the rows' change moves is projected out.
    """
    if rows.shape[0] == 0:
        return jnp.eye(rows.shape[1])
    q, _ = jnp.linalg.qr(lax.stop_gradient(rows.T), mode="complete")
    free, gram = q[:, rows.shape[0] :], product(rows, rows.T)
    small = 1e-10 * jnp.trace(gram) * jnp.eye(rows.shape[0])  # clamps may hold the same thing twice
    return free - product(rows.T, jnp.linalg.solve(gram + lax.stop_gradient(small), product(rows, free)))
