"""Rest states: `settle`.

At rest a regularised friction holds nothing: the sheet creeps. `settle` takes friction as it acts over `HOLD` seconds of
creep: the sliding speed is displacement / HOLD, so friction is a tangential spring that saturates at mu f_n. Springs,
contact stiffness, gravity and loads are exact; dampers play no part; driven shafts stand still. Where friction sticks, the
rest state then holds what was found by its deflections.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from diffeed.base.records import replace
from diffeed.chain.kinematics import nodes, pose
from diffeed.chain.state import State, initial_state
from diffeed.contact import stick
from diffeed.contact.candidates import touching_now
from diffeed.contact.kept import Kept, keep_all
from diffeed.contact.profile import interpolate
from diffeed.input.check_records import checked
from diffeed.input.packing import jit_of_scene
from diffeed.input.parts import Scene, warn_if_single
from diffeed.model.arrays import Drives, Model, Path
from diffeed.model.build import build
from diffeed.pair.law import Surface
from diffeed.readings.snapshot import look
from diffeed.statics.coordinates import generalised_force, generalised_inertia, held_places, positions, with_positions
from diffeed.statics.relax import Found, Rest, as_rest, dense, relaxed

HOLD = 0.02
"""s: friction at rest holds as over this time of creep."""
ANCHOR = 1e4
"""s: inertia over this time squared fixes what nothing else does (an idle roller that touches nothing)."""
FAR = 1e5
"""mm: what goes further to its rest is held by the anchor alone, a pinch that nothing stops."""
COLD, WARM = 1e-5, 1e-2
"""s2: squared length of the first implicit step of the search, from an unknown and from a nearby state."""


def at_rest(model: Model) -> Model:
    """The model without dampers, with shafts and guides standing still as at time 0."""

    def quiet(surface: Surface) -> Surface:
        return replace(surface, damping=None)

    def frozen(path: Path) -> Path:
        at = {k: interpolate(path.times, getattr(path, k), jnp.zeros(()))[0][:, None] for k in ("x", "y", "angle")}
        return replace(path, times=jnp.zeros((path.times.shape[0], 1)), **at)

    def stopped(drives: Drives) -> Drives:
        return Drives(times=drives.times, values=jnp.zeros_like(drives.values))

    bars, rollers = model.bars, model.rollers
    return replace(
        model,
        bars=replace(bars, joint_damping=jnp.zeros_like(bars.joint_damping)),
        rollers=replace(
            rollers,
            damper=jnp.zeros_like(rollers.damper),
            drag=jnp.zeros_like(rollers.drag),
            drives=(stopped(rollers.drives[0]), stopped(rollers.drives[1])),
        ),
        surface=quiet(model.surface),
        pair_surface=quiet(model.pair_surface),
        movements=replace(model.movements, path=frozen(model.movements.path)),
        wall_damping=jnp.zeros_like(model.wall_damping),
    )


def settle(scene: Scene, near: State | None = None) -> State:
    """Rest state of a scene: pinches down, sheets at rest in closed nips, cantilevers bent.

    `near`: the rest state of a scene that differs little, to begin the search with; it takes some ten iterations then.
    What friction holds still counts from where the scene's own records put things, so that the answer is the same.

    Differentiable by the implicit-function theorem. Where no rest state is found (a sheet in free fall) the state's
    numbers but the time are NaN, and a run started from it fails and says so. Raises SceneError for numbers that no scene can
    have.
    """
    scene = checked(scene)
    warn_if_single(scene)
    return _settle(scene, near)


@jit_of_scene
def _settle(scene: Scene, near: State | None) -> State:
    model = build(scene)
    state, converged = settle_model(model, initial_state(model, scene), near)
    # A factor, not a choice: the gradient of what was not found is NaN as well, never a silent zero.
    found = jax.tree.map(lambda v: v * jnp.where(converged, 1.0, jnp.nan).astype(v.dtype), state)
    return replace(found, time=state.time)


def settle_model(model: Model, start: State, near: State | None = None) -> tuple[State, Array]:
    """Rest state of what is let go at `start`, and whether it was found. The search begins at `near`, or at `start`."""
    guess = None if near is None else lax.stop_gradient(positions(model, near))
    start = replace(start, grip=None)
    # It scales steps, and anchors what nothing else holds: no part of the answer.
    inertia = generalised_inertia(*lax.stop_gradient((model, start)))
    freed = Freed(at_rest(model), start, inertia, guess)
    rest, converged = _balance(freed)
    found = with_positions(model, start, rest.q, jnp.zeros_like(rest.q))
    way = jnp.concatenate([found.x - start.x, found.y - start.y, found.travel - start.travel])
    return replace(found, grip=_grip_at_rest(freed, rest)), (converged > 0) & (jnp.max(jnp.abs(way)) < FAR)


class Freed(NamedTuple):
    """What is let go: the model without dampers, where it starts, its inertia in q, and where the search may begin."""

    model: Model
    start: State
    inertia: Array
    guess: Array | None


def _grip_at_rest(freed: Freed, rest: Rest) -> Array | None:
    """The deflections that hold what friction holds at a rest state, so that nothing jumps when it is let go."""
    still, start = freed.model, freed.start
    if not any(still.sticks):
        return None
    creeping = with_positions(still, start, rest.q, (rest.q - positions(still, start)) / HOLD)
    touching = look(still, creeping)[2]
    assert touching.sheets is not None
    return stick.at_friction(still, touching.sheets, keep_all(still))


def _look(freed: Freed, rest: Rest) -> tuple[Kept, Array]:
    """The pairs that touch at a would-be rest, and whether these are all."""
    still, start, _, _ = freed
    return touching_now(still, with_positions(still, start, rest.q, jnp.zeros_like(rest.q)))


def _imbalance(freed: Freed, rest: Rest, kept: Kept) -> Rest:
    """Generalised forces and clamp gaps that are left over at a would-be rest."""
    still, start, inertia, _ = freed
    q0 = positions(still, start)
    state = with_positions(still, start, rest.q, (rest.q - q0) / HOLD)
    (is_at, pull) = jax.vjp(lambda q: held_places(still, with_positions(still, start, q, q))[0], rest.q)
    belongs = held_places(still, start)[1]
    force = generalised_force(still, state, kept) + pull(rest.reaction)[0]
    return Rest(force - inertia * (rest.q - q0) / ANCHOR**2, is_at - belongs)


@jax.custom_jvp
def _balance(freed: Freed) -> tuple[Rest, Array]:
    """Where the imbalance vanishes, and 1.0 if it was found, else 0.0."""
    found = _search_rest(freed)
    return found.rest, found.found


@_balance.defjvp
def _balance_moves(primals: tuple[Freed], tangents: tuple[Freed]) -> tuple[Any, Any]:
    """Implicit-function theorem: the rest moves by the change of the imbalance over its slope.

    `lax.custom_root` does the same; it traces and compiles the slope twice more, where this rule takes it from the search.
    """
    found = _balance_and_slope(*primals)
    move = _move(found, *primals, *tangents)
    return (found.rest, found.found), (move, jnp.zeros_like(found.found))


@jax.custom_jvp
def _balance_and_slope(freed: Freed) -> Found:
    """The same and its slope, by a rule of its own: what derivatives of derivatives need is not traced for the first."""
    return _search_rest(freed)


@_balance_and_slope.defjvp
def _balance_and_slope_move(primals: tuple[Freed], tangents: tuple[Freed]) -> tuple[Any, Any]:
    """Likewise, and how the slope changes."""
    (freed,), (freed_dot,) = primals, tangents
    found = _balance_and_slope(freed)
    move = _move(found, freed, freed_dot)

    def slope(freed: Freed, rest: Rest) -> Array:
        return dense(jax.jacfwd(lambda r: _imbalance(freed, r, keep_all(freed.model)))(rest))

    _, slope_dot = jax.jvp(slope, (freed, found.rest), (freed_dot, move))
    return found, Found(move, jnp.zeros_like(found.found), slope_dot)


def _move(found: Found, freed: Freed, freed_dot: Freed) -> Rest:
    _, change = jax.jvp(lambda f: _imbalance(f, found.rest, keep_all(f.model)), (freed,), (freed_dot,))
    move = jnp.linalg.solve(found.slope, -jnp.concatenate(change))
    return as_rest(move, found.rest)


def _search_rest(freed: Freed) -> Found:
    """Where the imbalance vanishes. The slope comes from the loop, which has it anyway: outside, it would be compiled again."""
    still, start, inertia, near = freed
    q0, span2 = (positions(still, start), COLD) if near is None else (near, WARM)
    guess = Rest(q0, jnp.zeros_like(held_places(still, start)[1]))
    limit = _step_limit(still, start)
    return relaxed(partial(_look, freed), partial(_imbalance, freed), guess, inertia, limit, span2)


def _step_limit(model: Model, state: State):
    """Share of a Newton step that moves no bar by more than a safe amount (it might jump through a guide)."""
    touchable = bool(model.circle_names)
    before = nodes(model, pose(model, state))

    def share(q: Array, dq: Array) -> Array:
        after = nodes(model, pose(model, with_positions(model, state, q + dq, dq)))
        start = nodes(model, pose(model, with_positions(model, state, q, dq)))
        n = len(model.layout.bars)
        turn = jnp.max(jnp.abs(dq[2 * n : 2 * n + model.layout.n_bars]))
        reach = jnp.max(jnp.hypot(after[0] - start[0], after[1] - start[1]))
        size = jnp.max(jnp.hypot(before[0] - before[0][0], before[1] - before[1][0]))
        allowed = 1.0 if touchable else jnp.maximum(0.2 * size, 1.0)
        tiny = jnp.finfo(q.dtype).tiny
        return jnp.minimum(1.0, jnp.minimum(0.3 / jnp.maximum(turn, tiny), allowed / jnp.maximum(reach, tiny)))

    return share
