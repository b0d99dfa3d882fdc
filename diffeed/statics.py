"""Rest states and small vibrations: `settle` and `linearise`.

At rest a regularised friction holds nothing: the sheet creeps. `settle` takes friction as it acts over `HOLD` seconds of
creep: the sliding speed is displacement / HOLD, so friction is a tangential spring that saturates at mu f_n. Springs,
contact stiffness, gravity and loads are exact; dampers play no part; driven shafts stand still. Where friction sticks, the
rest state then holds what was found by its deflections.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from diffeed import stick
from diffeed.bodies import bodies, interpolate
from diffeed.contact import Kept, keep_all
from diffeed.contact_law import Surface
from diffeed.forces import (
    Contacts,
    Step,
    border,
    by_direction,
    contacts,
    hold_target,
    joints,
    pair_terms,
    pushes,
    walls,
    weight,
)
from diffeed.kinematics import nodes, pose
from diffeed.model import Drives, Hold, Model, Path, build
from diffeed.packing import jit_of_scene
from diffeed.parts import Scene, normalise, warn_if_single
from diffeed.records import record, replace, word
from diffeed.smooth import divide
from diffeed.snapshot import look
from diffeed.state import State, initial_state

HOLD = 0.02
"""s: friction at rest holds as over this time of creep."""
ANCHOR = 1e4
"""s: inertia over this time squared fixes what nothing else does (an idle roller that touches nothing)."""
ITERATIONS = 500
WARY, BOLD, BOLDER = 0.5, 4.0, 1.05
"""How far what a step of the search leaves may be off what was foreseen, as a share of what there was: at first and after a
step refused, at most, and its growth with each step taken. (Contacts that open and close want 0.5; with it alone a
sheet that only bends takes up to twenty times as many steps.)"""
LONGER = 4.0
"""Largest growth of the squared length of a step of the search from one to the next."""
COLD, WARM = 1e-5, 1e-2
"""s2: squared length of the first implicit step of the search, from an unknown and from a nearby state."""


class Rest(NamedTuple):
    """Unknowns of a static solve: generalised positions and clamp reactions."""

    q: Array
    reaction: Array


# --- generalised coordinates: mass centres, headings, travels, free angles -------------------------------------------


def positions(model: Model, state: State) -> Array:
    """q: (2 sheets + bars + movable + free,)."""
    return jnp.concatenate([state.x, state.y, state.heading, state.travel, state.angle[model.rollers.free]])


def velocities(state: State) -> Array:
    """Rates of q."""
    return jnp.concatenate([state.vx, state.vy, state.rate, state.travel_rate, state.spin])


def with_positions(model: Model, state: State, q: Array, v: Array) -> State:
    """The state with positions q and rates v."""
    s, n, m = len(model.layout.bars), model.layout.n_bars, model.rollers.n_movable
    cuts = [s, 2 * s, 2 * s + n, 2 * s + n + m]
    x, y, heading, travel, angle = jnp.split(q, cuts)
    vx, vy, rate, travel_rate, spin = jnp.split(v, cuts)
    return replace(
        state, x=x, y=y, heading=heading, travel=travel, angle=state.angle.at[model.rollers.free].set(angle),
        vx=vx, vy=vy, rate=rate, travel_rate=travel_rate, spin=spin,
    )  # fmt: skip


def generalised_force(model: Model, state: State, pressed: Array | None = None) -> Array:
    """Force on each entry of q at a state (no inertia, no clamps), kg mm/s2 and kg mm2/s2.

    Friction sticks as the state's deflections say, by the normal forces `pressed` (the present ones if None); in a state
    without deflections it is regularised.
    """
    at = pose(model, state)
    world = bodies(model, state, state.time, state.time)
    kept = keep_all(model)
    touching = contacts(model, at, world, kept, state.grip, pressed=pressed)
    plain = Step(jnp.ones(()), False)
    terms = [weight(model), joints(model, state, plain), pushes(model, at), walls(model, state, plain)]
    terms += [pair_terms(model, touching.sheets, at, plain)] if touching.sheets is not None else []
    total = [sum((getattr(t, f) for t in terms if t is not None), jnp.zeros_like(at.x)) for f in ("fx", "fy", "fw")]
    on_rollers = _force_on_rollers(model, state, touching, plain, kept)
    _, pull_back = jax.vjp(lambda q: _centres(model, state, q), positions(model, state))
    (on_sheets,) = pull_back((total[0], total[1], total[2]))
    n = on_sheets.shape[0] - on_rollers.shape[0]
    return on_sheets.at[n:].add(on_rollers)


def _centres(model: Model, state: State, q: Array) -> tuple[Array, Array, Array]:
    moved = with_positions(model, state, q, jnp.zeros_like(q))
    at = pose(model, moved)
    return at.x, at.y, moved.heading


def _force_on_rollers(model: Model, state: State, touching: Contacts, plain: Step, kept: Kept) -> Array:
    free = model.rollers.n_movable + model.rollers.n_free
    return border(model, state, touching, plain, kept).rhs if free else jnp.zeros((0,))


def held_places(model: Model, state: State) -> tuple[Array, Array]:
    """Where the clamps' rows are and where they belong, each (rows,)."""
    at = pose(model, state)
    is_at, belongs = [jnp.zeros((0,))], [jnp.zeros((0,))]
    for hold in model.holds:
        place = _place(model, state, at, hold)
        target = by_direction(hold_target(hold, state.time))
        is_at += [place[d][None] for d in hold.rows]
        belongs += [target[d][None] for d in hold.rows]
    return jnp.concatenate(is_at), jnp.concatenate(belongs)


def _place(model: Model, state: State, at: Any, hold: Hold) -> dict[str, Array]:
    arm = hold.end * model.bars.half_length[hold.bar]
    k = hold.bar
    return by_direction((at.x[k] + arm * at.c[k], at.y[k] + arm * at.s[k], state.heading[k]))


# --- settle -------------------------------------------------------------------------------------------------------------


def at_rest(model: Model) -> Model:
    """The model without dampers, with shafts and guides standing still as at time 0."""

    def quiet(surface: Surface) -> Surface:
        return replace(surface, damping=None)

    def frozen(path: Path) -> Path:
        at = {k: interpolate(path.times, getattr(path, k), jnp.zeros(()))[0][None] for k in ("x", "y", "angle")}
        return replace(path, times=jnp.zeros((1,)), **at)

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
        paths={k: frozen(p) for k, p in model.paths.items()},
        wall_damping=jnp.zeros_like(model.wall_damping),
    )


def settle(scene: Scene, near: State | None = None) -> State:
    """Rest state of a scene: pinches down, sheets at rest in closed nips, cantilevers bent.

    `near`: the rest state of a scene that differs little, to begin the search with; it takes some ten iterations then.
    What friction holds still counts from where the scene's own records put things, so that the answer is the same.

    Differentiable by the implicit-function theorem. Where no rest state is found (a sheet in free fall) the state's
    numbers are NaN, so that a run started from it fails and says so.
    """
    scene = normalise(scene)
    warn_if_single(scene)
    return _settle(scene, near)


@jit_of_scene
def _settle(scene: Scene, near: State | None) -> State:
    model = build(scene)
    state, converged = settle_model(model, initial_state(model, scene), near)
    # A factor, not a choice: the gradient of what was not found is NaN as well, never a silent zero.
    return jax.tree.map(lambda v: v * jnp.where(converged, 1.0, jnp.nan).astype(v.dtype), state)


def settle_model(model: Model, start: State, near: State | None = None) -> tuple[State, Array]:
    """Rest state of what is let go at `start`, and whether it was found. The search begins at `near`, or at `start`."""
    guess = None if near is None else lax.stop_gradient(positions(model, near))
    start = replace(start, grip=None)
    # It scales steps, and anchors what nothing else holds: no part of the answer.
    inertia = generalised_inertia(*lax.stop_gradient((model, start)))
    freed = Freed(at_rest(model), start, inertia, guess)
    rest, converged = _balance(freed)
    found = with_positions(model, start, rest.q, jnp.zeros_like(rest.q))
    return replace(found, grip=_grip_at_rest(freed, rest)), converged > 0


class Freed(NamedTuple):
    """What is let go: the model without dampers, where it starts, its inertia in q, and where the search may begin."""

    model: Model
    start: State
    inertia: Array
    guess: Array | None


class _Found(NamedTuple):
    """What the search for a rest found: the rest, 1.0 if it is one, else 0.0, and the slope of the imbalance there."""

    rest: Rest
    found: Array
    slope: Array


def _grip_at_rest(freed: Freed, rest: Rest) -> Array | None:
    """The deflections that hold what friction holds at a rest state, so that nothing jumps when it is let go."""
    still, start = freed.model, freed.start
    if not any(still.sticks):
        return None
    creeping = with_positions(still, start, rest.q, (rest.q - positions(still, start)) / HOLD)
    at, _, touching = look(still, creeping)
    assert touching.sheets is not None
    return stick.at_friction(still, at, touching.sheets, keep_all(still))


def _imbalance(freed: Freed, rest: Rest) -> Rest:
    """Generalised forces and clamp gaps that are left over at a would-be rest."""
    still, start, inertia, _ = freed
    q0 = positions(still, start)
    state = with_positions(still, start, rest.q, (rest.q - q0) / HOLD)
    (is_at, pull) = jax.vjp(lambda q: held_places(still, with_positions(still, start, q, q))[0], rest.q)
    belongs = held_places(still, start)[1]
    force = generalised_force(still, state) + pull(rest.reaction)[0]
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
def _balance_and_slope(freed: Freed) -> _Found:
    """The same and its slope, by a rule of its own: what derivatives of derivatives need is not traced for the first."""
    return _search_rest(freed)


@_balance_and_slope.defjvp
def _balance_and_slope_move(primals: tuple[Freed], tangents: tuple[Freed]) -> tuple[Any, Any]:
    """Likewise, and how the slope changes."""
    (freed,), (freed_dot,) = primals, tangents
    found = _balance_and_slope(freed)
    move = _move(found, freed, freed_dot)

    def slope(freed: Freed, rest: Rest) -> Array:
        return _dense(jax.jacfwd(lambda r: _imbalance(freed, r))(rest))

    _, slope_dot = jax.jvp(slope, (freed, found.rest), (freed_dot, move))
    return found, _Found(move, jnp.zeros_like(found.found), slope_dot)


def _move(found: _Found, freed: Freed, freed_dot: Freed) -> Rest:
    _, change = jax.jvp(lambda f: _imbalance(f, found.rest), (freed,), (freed_dot,))
    move = jnp.linalg.solve(found.slope, -jnp.concatenate(change))
    return _rest(move, found.rest)


def _search_rest(freed: Freed) -> _Found:
    """Where the imbalance vanishes. The slope comes from the loop, which has it anyway: outside, it would be compiled again."""
    still, start, inertia, near = freed
    q0, span2 = (positions(still, start), COLD) if near is None else (near, WARM)
    guess = Rest(q0, jnp.zeros_like(held_places(still, start)[1]))
    return _relax(lambda rest: _imbalance(freed, rest), guess, inertia, _step_limit(still, start), span2)


def generalised_inertia(model: Model, state: State) -> Array:
    """Diagonal of the mass matrix in q."""
    bars, layout = model.bars, model.layout
    moved = jax.jacfwd(lambda h: pose(model, replace(state, heading=h))[:2])(state.heading)
    turning = bars.inertia + sum(jnp.sum(bars.mass[:, None] * j * j, axis=0) for j in moved)
    total = jnp.stack([jnp.sum(bars.mass[s]) for s in layout.slices()])
    return jnp.concatenate([total, total, turning, model.rollers.mass, model.rollers.inertia])


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


class _Search(NamedTuple):
    """Carry of the search: the point reached, what is left over there and its slope, and the step to try next."""

    tries: Array
    rest: Rest
    gap: Rest
    slope: Array
    left: Array  # size of the gap
    span2: Array  # s2: squared length of the next step
    allowed: Array  # how far the next step may be off, as a share of `left`
    done: Array


def _relax(imbalance: Any, guess: Rest, inertia: Array, limit: Any, first: float) -> _Found:
    """Pseudo-transient continuation: linearly implicit steps from rest, as long as their linearisation foresees what they
    leave, so that contacts that open and close do not throw the search to and fro; near the rest it ends in Newton's
    method."""
    dtype = guess.q.dtype
    # The shortest step, 0.1 us, follows bars of 1 mm past a friction that lets go; 10 us did not.
    smallest, largest = 1e-14, 1e14
    small = 1e-11 if dtype == jnp.float64 else 2e-5
    tiny, eps = jnp.finfo(dtype).tiny, jnp.finfo(dtype).eps

    def size(gap: Rest) -> Array:
        """Both kinds of imbalance as a displacement: forces as what 1 ms of free motion would make of them."""
        return jnp.max(jnp.abs(gap.q) / inertia) * 1e-6 + jnp.sum(jnp.abs(gap.reaction))

    def carry_on(at: _Search) -> Array:
        return (at.tries < ITERATIONS) & ~at.done

    def improve(at: _Search) -> _Search:
        step = _newton_step(at.slope, at.gap, inertia / at.span2)
        share = limit(at.rest.q, step.q)
        trial = jax.tree.map(lambda r, d: r + share * d, at.rest, step)
        jacobian, gap = jax.jacfwd(lambda r: (imbalance(r),) * 2, has_aux=True)(trial)
        foreseen = Rest((1.0 - share) * at.gap.q + share * inertia / at.span2 * step.q, (1.0 - share) * at.gap.reaction)
        slope = _dense(jacobian)
        # Round-off of stiff springs on light bars must neither hold steps back nor refuse any. (A few roundings each: 8. What
        # lies at 0 is rounded as well, as radii and centres are that place it: 1 mm.)
        noise = 8.0 * eps * size(_rest(jnp.abs(slope) @ (1.0 + jnp.abs(jnp.concatenate(trial))), trial))
        left = jnp.maximum(size(gap), noise)
        # A step too short to count, that was not held back, surprises nobody: light bars flicker at a friction that lets go.
        close = jnp.max(jnp.abs(step.q)) < small * (1.0 + jnp.max(jnp.abs(trial.q)))
        off = jnp.maximum(size(jax.tree.map(jnp.subtract, gap, foreseen)) - noise, 0.0)
        surprise = jnp.where(close & (at.span2 > first), 0.0, off / at.left)
        # What no shorter step would better is taken: clamps that move at once may leave nothing else.
        taken = (surprise <= at.allowed) | (left <= at.left) | (at.span2 <= smallest)
        good = jnp.isfinite(left) & taken
        # What a linearisation leaves out grows as the square of the step; the next one aims at half of what is allowed.
        change = jnp.clip(jnp.sqrt(0.5 * at.allowed / jnp.maximum(surprise, tiny)), 0.1, LONGER)
        change = jnp.minimum(change, jnp.where(good, jnp.where(share >= 1.0, LONGER, 1.0), 0.5))
        span2 = jnp.clip(jnp.where(jnp.isfinite(left), change, 0.1) * at.span2, smallest, largest)
        done = good & (share >= 1.0) & close & (at.span2 > 1e2)
        bolder = jnp.minimum(BOLDER * at.allowed, BOLD)
        reached = _Search(at.tries, trial, gap, slope, left, span2, bolder, done)
        stayed = at._replace(span2=span2, allowed=jnp.full_like(at.allowed, WARY))
        return jax.tree.map(lambda a, b: jnp.where(good, a, b), reached, stayed)._replace(tries=at.tries + 1)

    last = lax.while_loop(carry_on, improve, _begun(guess, first))
    return _Found(last.rest, last.done.astype(dtype), last.slope)


def _begun(guess: Rest, first: float) -> _Search:
    """A search that has not looked yet: it finds nothing left over, so that its first step stays and looks. (A look outside
    the loop would be compiled again.)"""
    dtype, none = guess.q.dtype, jax.tree.map(jnp.zeros_like, guess)
    slope = -jnp.eye(guess.q.shape[0] + guess.reaction.shape[0], dtype=dtype)
    left, span2, allowed = (jnp.full((), v, dtype) for v in (jnp.inf, first / LONGER, WARY))
    return _Search(jnp.zeros((), jnp.int32), guess, none, slope, left, span2, allowed, jnp.zeros((), bool))


def _newton_step(slope: Array, gap: Rest, shift: Array) -> Rest:
    """Solve (shift - dG/dy) step = G; `shift` acts on positions only."""
    diagonal = jnp.concatenate([shift, jnp.zeros_like(gap.reaction)])
    step = jnp.linalg.solve(jnp.diag(diagonal) - slope, jnp.concatenate([gap.q, gap.reaction]))
    return _rest(step, gap)


def _rest(values: Array, like: Rest) -> Rest:
    """One row of unknowns, split as in `like`."""
    n = like.q.shape[0]
    return Rest(values[:n], values[n:])


def _dense(jacobian: Any) -> Array:
    return jnp.block([[jacobian.q.q, jacobian.q.reaction], [jacobian.reaction.q, jacobian.reaction.reaction]])


# --- linearise ----------------------------------------------------------------------------------------------------------


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

    def modes(self) -> tuple[np.ndarray, np.ndarray]:
        """Undamped angular frequencies (rad/s, ascending; NaN-free: an unstable mode is negative) and shapes in columns."""
        import scipy.linalg

        square, shapes = scipy.linalg.eigh(np.asarray(self.stiffness), np.asarray(self.mass))
        return np.sign(square) * np.sqrt(np.abs(square)), np.asarray(self.basis) @ shapes

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
    it acts there: regularised, as a damper; sticking, as a tangential spring under the normal force of that state.
    """
    return _linearise(normalise(scene), state)


@jit_of_scene
def _linearise(scene: Scene, state: State) -> Linearisation:
    model = build(scene)
    state = stick.fitted(model, state)
    q, v = positions(model, state), velocities(state)
    pressed = None if state.grip is None else _pressed(model, state)

    def force(q: Array, v: Array) -> Array:
        moved = with_positions(model, state, q, v)
        return generalised_force(model, replace(moved, grip=_dragged_grip(model, state, q)), pressed)

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
        small = basis.T @ matrix @ basis
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


def mass_matrix(model: Model, state: State) -> Array:
    """Mass matrix in q, exact at this pose."""
    q = positions(model, state)
    moved = jax.jacfwd(lambda q: _centres(model, state, q))(q)
    bars = model.bars
    weights = (bars.mass, bars.mass, bars.inertia)
    sheets = sum(j.T @ (w[:, None] * j) for j, w in zip(moved, weights, strict=True))
    n = q.shape[0] - model.rollers.n_movable - model.rollers.n_free
    extra = jnp.concatenate([jnp.zeros((n,)), model.rollers.mass, model.rollers.inertia])
    return sheets + jnp.diag(extra)


def _null_space(rows: Array) -> Array:
    """Orthonormal basis (coordinates, free) of the motions that the clamps allow, by a complete QR factorisation.

    The factorisation has no derivative: the basis is held constant and what the rows' change moves is projected out.
    """
    if rows.shape[0] == 0:
        return jnp.eye(rows.shape[1])
    q, _ = jnp.linalg.qr(lax.stop_gradient(rows.T), mode="complete")
    free, gram = q[:, rows.shape[0] :], rows @ rows.T
    small = 1e-10 * jnp.trace(gram) * jnp.eye(rows.shape[0])  # clamps may hold the same thing twice
    return free - rows.T @ jnp.linalg.solve(gram + lax.stop_gradient(small), rows @ free)
