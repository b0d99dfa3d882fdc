"""Forces, one named function per cause, and `assemble`, which sums them into the system of a step.

Implicit terms: with step h, a contact of force F, stiffness K and damping C adds (h^2 K + h C) g_n g_n' to the matrix
and F - h K v_n to the force; friction adds h (mu F phi/v_t) g_t g_t' and its force, sticking friction its own secant. With
`implicit=False` all h-terms are left out: the plain equations of motion.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from diffeed import stick
from diffeed.batching import any_of_batch
from diffeed.bodies import Bodies, bodies, shift_at
from diffeed.contact import Kept, Lever, Pairs, RollerPairs, by_circle, roller_contacts, shared, sheet_contacts, to_bars
from diffeed.kinematics import Pose, pose
from diffeed.model import Hold, Model
from diffeed.state import State
from diffeed.sums import up_to_centre
from diffeed.system import BarTerms, Border, Clamped, System


class Contacts(NamedTuple):
    """All evaluated contacts of one state, None where a scene has no such part, and the pose that they saw."""

    sheets: Pairs | None
    rollers: RollerPairs | None
    at: Pose


class Step(NamedTuple):
    """Length of a step and whether its end is felt: h = 0 gives the plain equations of motion."""

    h: Array
    implicit: bool


def contacts(
    model: Model,
    at: Pose,
    world: Bodies,
    kept: Kept,
    grip: Array | None,
    ahead: Array | float = 0.0,
    pressed: Array | None = None,
) -> Contacts:
    """Sweep the kept bodies. `grip` are the state's deflections; sticking friction is that of `ahead` seconds later, by the
    normal forces `pressed` if given."""
    held = stick.of_pairs(model, grip, kept, ahead, pressed)
    return Contacts(
        sheets=sheet_contacts(model, at, world, kept, held) if model.has_bodies else None,
        rollers=roller_contacts(model, world, kept) if model.pairs else None,
        at=at,
    )


def assemble(model: Model, state: State, step: Step, kept: Kept) -> tuple[System, Pose, Contacts]:
    """The linear system of a step from `state`, with the pose and the contacts that it saw."""
    with jax.named_scope("pose"):
        at = pose(model, state)
        world = bodies(model, state, state.time, state.time + step.h if step.implicit else state.time)
    with jax.named_scope("contact"):
        touching = contacts(model, at, world, kept, state.grip, step.h if step.implicit else 0.0)
    with jax.named_scope("forces"):
        terms = [inertia(model), weight(model), joints(model, state, step), tension(state, step)]
        terms += [pushes(model, at), walls(model, state, step)]
        terms += [pair_terms(model, touching.sheets, at, step)] if touching.sheets is not None else []
        half = model.bars.half_length
        centripetal = half * state.rate * state.rate
        system = System(
            bars=_sum([t for t in terms if t is not None]),
            coupling=_coupling(model, step),
            lever_x=half * at.s,
            lever_y=-half * at.c,
            bias_x=centripetal * at.c,
            bias_y=centripetal * at.s,
            border=border(model, state, touching, step, kept) if model.n_border else None,
            clamps=clamps(model, state, at, step) if model.holds else None,
        )
    return system, at, touching


def _terms(model: Model, **given: Array) -> BarTerms:
    """Bar terms with the given entries and zeros elsewhere."""
    zero = jnp.zeros_like(model.bars.mass)
    return BarTerms(**{name: given.get(name, zero) for name in BarTerms._fields})


def _sum(terms: list[BarTerms]) -> BarTerms:
    return BarTerms(*(functools.reduce(jnp.add, entries) for entries in zip(*terms, strict=True)))


# --- the sheet's own -----------------------------------------------------------------------------------------------


def inertia(model: Model) -> BarTerms:
    """Mass matrix: diagonal, for the centre is the mass centre."""
    return _terms(model, xx=model.bars.mass, yy=model.bars.mass, ww=model.bars.inertia)


def weight(model: Model) -> BarTerms:
    """Gravity."""
    return _terms(model, fx=model.bars.mass * model.gravity[0], fy=model.bars.mass * model.gravity[1])


def joint_moments(model: Model, state: State, lag: Array | float = 0.0) -> Array:
    """(bars,) moment of the joint behind each bar on that bar (source paper, eq. 3, about the rest angle); the next bar
    feels the opposite. `lag` adds stiffness times lag to the damping: the moment at the end of a step."""
    bars = model.bars
    bend = state.heading - jnp.roll(state.heading, -1) - bars.rest_angle
    rate = state.rate - jnp.roll(state.rate, -1)
    return -bars.joint_stiffness * bend - (bars.joint_damping + lag * bars.joint_stiffness) * rate


def joints(model: Model, state: State, step: Step) -> BarTerms:
    """Rotational spring-dampers; their implicit part is the system's `coupling`."""
    moment = joint_moments(model, state, step.h if step.implicit else 0.0)
    return _terms(model, fw=moment - jnp.roll(moment, 1))


def _coupling(model: Model, step: Step) -> Array:
    if not step.implicit:
        return jnp.zeros_like(model.bars.mass)
    return step.h * (model.bars.joint_damping + step.h * model.bars.joint_stiffness)


def tension(state: State, step: Step) -> BarTerms | None:
    """Geometric stiffness of joint forces, its positive part, from the last step: a taut sheet needs it."""
    if not step.implicit:
        return None
    taut = step.h * jnp.maximum(state.stretch, 0.0)
    zero = jnp.zeros_like(taut)
    return BarTerms(zero, zero, zero, zero, zero, step.h * taut, zero, zero, -taut * state.rate)


def joint_stretch(model: Model, at: Pose, net_x: Array, net_y: Array) -> Array:
    """(bars,) geometric stiffness per heading: half length times (pull at the front + pull at the rear).

    `net_x`, `net_y`: net joint force on each bar; sums from the lead give the force at each joint.
    """
    pull_x, pull_y = up_to_centre(model.layout, jnp.stack([net_x, net_y]))
    return -2.0 * model.bars.half_length * (at.c * pull_x + at.s * pull_y)


# --- loads and clamps ------------------------------------------------------------------------------------------------


def _one_bar(model: Model, bar: int, value: Array) -> Array:
    return jnp.zeros_like(model.bars.mass).at[bar].set(value)


def pushes(model: Model, at: Pose) -> BarTerms | None:
    """Dead forces and moments on nodes."""
    if not model.pushes:
        return None
    found = []
    for p in model.pushes:
        arm = p.end * model.bars.half_length[p.bar]
        moment = p.moment + arm * (at.c[p.bar] * p.y - at.s[p.bar] * p.x)
        found.append(
            _terms(model, **{k: _one_bar(model, p.bar, v) for k, v in (("fx", p.x), ("fy", p.y), ("fw", moment))})
        )
    return _sum(found)


def hold_target(hold: Hold, time: Array) -> tuple[Array, Array, Array]:
    """Where a clamp holds its node (mm) and heading (rad) at a time."""
    if hold.path is None:
        return hold.x, hold.y, hold.angle
    shift = shift_at(hold.path, time)
    return hold.x + shift.dx, hold.y + shift.dy, hold.angle + shift.angle


def by_direction(values: tuple[Array, Array, Array]) -> dict[str, Array]:
    """(x, y, heading) by the words that a clamp's rows use."""
    return dict(zip(("x", "y", "heading"), values, strict=True))


def walls(model: Model, state: State, step: Step) -> BarTerms | None:
    """Wall joints: a spring-damper of twice the joint's stiffness between the wall and the bar at its node."""
    found = []
    for hold in model.holds:
        if not hold.wall:
            continue
        k, c = 2.0 * model.wall_stiffness[hold.bar], 2.0 * model.wall_damping[hold.bar]
        rate, lag = state.rate[hold.bar], (step.h if step.implicit else 0.0)
        angle = hold_target(hold, state.time + lag)[2]
        moment = -k * (state.heading[hold.bar] - angle) - (c + lag * k) * rate
        terms = {"fw": _one_bar(model, hold.bar, moment)}
        if step.implicit:
            terms["ww"] = _one_bar(model, hold.bar, step.h * (c + step.h * k))
        found.append(_terms(model, **terms))
    return _sum(found) if found else None


# --- contact -------------------------------------------------------------------------------------------------------


class Felt(NamedTuple):
    """A contact as the step feels it; along the tangent None where nothing has friction."""

    a_n: Array  # added to the matrix along the normal, kg
    a_t: Array | None  # and along the tangent
    f_n: Array  # force along the normal, kg mm/s2
    f_t: Array | None

    def full(self) -> tuple[Array, Array, Array, Array]:
        """The same with zeros."""
        zero = jnp.zeros_like(self.f_n)
        return self.a_n, zero if self.a_t is None else self.a_t, self.f_n, zero if self.f_t is None else self.f_t


def felt(pairs: Pairs | RollerPairs, step: Step) -> Felt:
    """Implicit parts of contacts: (h^2 K + h C), h times the secant of friction, F - h K v_n, and minus friction."""
    touch, h = pairs.touch, step.h
    f_t = None if touch.secant is None else -touch.friction
    if not step.implicit:
        zero = jnp.zeros_like(touch.force)
        return Felt(zero, None if f_t is None else zero, touch.force, f_t)
    lagged = h * touch.stiffness
    a_n = h * (lagged if touch.damping is None else lagged + touch.damping)
    a_t = None if touch.secant is None else h * touch.secant
    return Felt(a_n, a_t, touch.force - lagged * pairs.v_n, f_t)


def pair_terms(model: Model, pairs: Pairs, at: Pose, step: Step) -> BarTerms:
    """Contacts summed over bodies, features given back to their bars.

    A contact on two bars with shares s_j feels g.v = sum s_j g_j.v. Its own matrix g g' has a block between the two bars, for
    which the chain has no place. In it stands sum s_j g_j g_j', which is at least g g' because a square is convex: symmetric,
    positive, so that the step stays stable, and the force is the exact one; the difference resists changes of the two bars'
    relative speed and vanishes with the step.
    """
    e = felt(pairs, step)
    entries = [_entries(pairs, lever, e, step) for lever in pairs.levers]
    # Stacked, then summed at once: summed one by one, each would compute the contact law again.
    sums = jnp.sum(jnp.stack([entry for each in entries for entry in each]), axis=1)
    fx, fy, fw, *matrix = to_bars(model, jnp.split(sums, len(entries)))
    if not step.implicit:
        return _terms(model, fx=fx, fy=fy, fw=fw)
    xx, xy, yy, xw, yw, ww, turning = matrix
    return BarTerms(xx, xy, yy, xw, yw, ww + step.h * turning, fx, fy, fw - turning * at.w)


def _entries(pairs: Pairs, lever: Lever, pair: Felt, step: Step) -> list[Array]:
    """What pairs add to one of their bars: force, and if implicit matrix and geometric stiffness; (bodies, features) each."""
    e, nx, ny = jax.tree.map(lambda v: shared(lever, v), pair), pairs.nx, pairs.ny
    entries = _along(e.f_n, e.a_n, nx, ny, lever.rn, step)
    if e.a_t is not None and e.f_t is not None:
        entries = [n + t for n, t in zip(entries, _along(e.f_t, e.a_t, -ny, nx, lever.rt, step), strict=True)]
    return entries + ([step.h * shared(lever, pairs.turning)] if step.implicit else [])


def _along(f: Array, a: Array, x: Array, y: Array, r: Array, step: Step) -> list[Array]:
    """A force f along g = (x, y, r) of a bar, and if implicit the entries xx, xy, yy, xw, yw, ww of a g g'."""
    force = [f * x, f * y, f * r]
    if not step.implicit:
        return force
    ax, ay = a * x, a * y
    return [*force, ax * x, ax * y, ay * y, ax * r, ay * r, a * r * r]


# --- rollers and clamps -----------------------------------------------------------------------------------------------


def border(model: Model, state: State, touching: Contacts, step: Step, kept: Kept) -> Border:
    """Travels and free spins: their own terms and their coupling to the bars."""
    rollers, n_bars = model.rollers, model.layout.n_bars
    m, f = rollers.n_movable, rollers.n_free
    travel_diag, travel_force = _travel_terms(model, state, step)
    spin_diag, spin_force = _spin_terms(model, state, step)
    travel, spin = _both(rollers.counts)
    twin = np.arange(m + f)
    twin[travel], twin[spin] = spin, travel
    own, mixed = jnp.concatenate([travel_diag, spin_diag]), jnp.zeros((m + f,))
    rhs, columns = jnp.concatenate([travel_force, spin_force]), jnp.zeros((m + f, 3, n_bars))
    beside = Border(columns, rhs, own, mixed, twin, lambda: jnp.zeros((m + f, m + f)), True)
    if touching.sheets is not None and m + f:
        beside = _sheet_on_rollers(model, touching.sheets, step, kept, beside)
    if touching.rollers is not None:
        beside = _rollers_on_rollers(model, touching.rollers, step, beside)
    return beside


def clamps(model: Model, state: State, at: Pose, step: Step) -> Clamped:
    """Rows of all clamps."""
    rows = [_hold_rows(model, state, at, hold, step) for hold in model.holds]
    return Clamped(*(jnp.concatenate(v) for v in zip(*rows, strict=True)))


def _travel_terms(model: Model, state: State, step: Step) -> tuple[Array, Array]:
    """Movable rollers along their travel: inertia, gravity, spring with preload, damper, stops."""
    r, u, v = model.rollers, state.travel, state.travel_rate
    over, under = jnp.maximum(u - r.stop_high, 0.0), jnp.maximum(r.stop_low - u, 0.0)
    stiffness = r.spring + jnp.where((over > 0) | (under > 0), r.stop_stiffness, 0.0)
    force = -(r.preload + r.spring * u) - r.damper * v - r.stop_stiffness * (over - under)
    force = force + r.mass * (model.gravity[0] * r.dir_x + model.gravity[1] * r.dir_y)
    if not step.implicit:
        return r.mass, force
    return r.mass + step.h * (r.damper + step.h * stiffness), force - step.h * stiffness * v


def _spin_terms(model: Model, state: State, step: Step) -> tuple[Array, Array]:
    """Freely turning rollers: inertia and bearing drag."""
    r = model.rollers
    drag = -r.drag * state.spin
    return (r.inertia + step.h * r.drag if step.implicit else r.inertia), drag


def _sheet_on_rollers(model: Model, pairs: Pairs, step: Step, kept: Kept, beside: Border) -> Border:
    """Add the coupling of bars with travels and spins. A roller feels -n, -t along its travel and -R t in its spin."""
    rollers, m, n = model.rollers, model.rollers.n_movable, kept.n_circles
    roller = np.concatenate([np.arange(rollers.n)[rollers.movable], np.arange(rollers.n)[rollers.free]])
    kind = np.arange(model.n_border) >= m  # of each row of the border: travel, spin
    a_n, a_t, f_n, f_t = (v[:n] for v in felt(pairs, step).full())
    nx, ny = pairs.nx[:n], pairs.ny[:n]
    gn = -(kept.travel_x * nx + kept.travel_y * ny)
    gt = kept.travel_x * ny - kept.travel_y * nx
    gs = -kept.spin_lever
    own = [f_n * gn + f_t * gt, f_t * gs]
    if not step.implicit:  # no end of a step is felt: nothing is coupled
        rhs = jnp.sum(by_circle(kept, jnp.stack(own)[None], roller, kind)[0], axis=1)
        return beside._replace(rhs=beside.rhs + rhs)
    an, at, asp = a_n * gn, a_t * gt, a_t * gs
    felt_by = []
    for lever in jax.tree.map(lambda v: v[:n], pairs.levers):
        rn, rt = lever.rn, lever.rt
        # What the bar couples (x, y, turning) to a travel and to a spin.
        coupled = [an * nx - at * ny, -asp * ny, an * ny + at * nx, asp * nx, an * rn + at * rt, asp * rt]
        felt_by += [shared(lever, v) for v in coupled]
    felt_by += [an * gn + at * gt, asp * gs, *own]
    table = jnp.stack(felt_by).reshape(-1, 2, *nx.shape)
    rows = by_circle(kept, table, roller, kind)
    columns = to_bars(model, jnp.split(rows[:-2], len(pairs.levers))).swapaxes(0, 1)
    diagonal, rhs = jnp.sum(rows[-2:], axis=2)
    mixed = beside.mixed
    if rollers.counts[1]:
        # A movable free roller has both: its travel and its spin couple through friction.
        travel = _both(rollers.counts)[0]
        mixed = mixed + _twice(
            rollers.counts, jnp.sum(by_circle(kept, (at * gs)[None, None], roller[travel])[0], axis=1)
        )
    return beside._replace(columns=columns, rhs=beside.rhs + rhs, own=beside.own + diagonal, mixed=mixed)


def _twice(counts: tuple[int, int, int, int], mixed: Array) -> Array:
    """(movable free rollers,) -> (border,): what couples travel and spin, at both."""
    before, after = jnp.zeros((counts[0],)), jnp.zeros((counts[2],))
    return jnp.concatenate([before, mixed, mixed, after])


def _both(counts: tuple[int, int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Border rows (travel, spin) of the rollers that have both."""
    return counts[0] + np.arange(counts[1]), sum(counts[:2]) + np.arange(counts[1])


def _rollers_on_rollers(model: Model, pairs: RollerPairs, step: Step, beside: Border) -> Border:
    """Add rollers against each other. They are summed as rows of g_n and g_t in all unknowns where they are few. Where each
    movable roller has its own partners, partners without unknowns (driven, on fixed shafts) need no such rows, and others
    only while they touch."""
    if pairs.gap.ndim == 1:
        full, rhs = _of_all(model, pairs, step)
        return beside._replace(rhs=beside.rhs + rhs, rest=lambda: full, apart=None)
    flat, none = jax.tree.map(jnp.ravel, pairs), jnp.zeros((model.n_border,))
    coupled = any_of_batch(jnp.any((pairs.between[1] < sum(model.rollers.counts[:3])) & (pairs.gap < 0.0)))
    rhs, own, mixed = _on_partners(model, pairs, step)
    # Where any are coupled all come from the rows, and the sums are left out.
    alone = jnp.where(coupled, 0.0, 1.0)
    rhs = alone * rhs + lax.cond(coupled, lambda: _of_all(model, flat, step)[1], lambda: none)
    return beside._replace(
        rhs=beside.rhs + rhs,
        own=beside.own + alone * own,
        mixed=beside.mixed + alone * mixed,
        rest=lambda: lax.cond(coupled, lambda: _of_all(model, flat, step)[0], lambda: jnp.diag(none)),
        apart=~coupled,
    )


def _on_partners(model: Model, pairs: RollerPairs, step: Step) -> tuple[Array, Array, Array]:
    """Right-hand side, own and mixed terms of movable rollers, (border,) each, from their partners, (movable, partners)."""
    rollers, start = model.rollers, model.rollers.counts[0]
    a_n, a_t, f_n, f_t = felt(pairs, step).full()
    dx, dy = rollers.dir_x[:, None], rollers.dir_y[:, None]
    along, across = pairs.nx * dx + pairs.ny * dy, pairs.nx * dy - pairs.ny * dx
    turn, rest = -rollers.radius[start : rollers.n_movable, None], jnp.zeros((rollers.counts[2],))
    rhs = jnp.concatenate([jnp.sum(f_n * along + f_t * across, axis=1), jnp.sum(f_t[start:] * turn, axis=1), rest])
    if not step.implicit:
        return rhs, jnp.zeros_like(rhs), jnp.zeros_like(rhs)
    own = [jnp.sum(a_n * along**2 + a_t * across**2, axis=1), jnp.sum(a_t[start:] * turn**2, axis=1), rest]
    mixed = jnp.sum(a_t[start:] * across[start:] * turn, axis=1)
    return rhs, jnp.concatenate(own), _twice(rollers.counts, mixed)


def _of_all(model: Model, pairs: RollerPairs, step: Step) -> tuple[Array, Array]:
    """Rows of g_n and g_t in all unknowns, (pairs, border): their weighed product, and the right-hand side."""
    rollers, m, f = model.rollers, model.rollers.n_movable, model.rollers.n_free
    a_n, a_t, f_n, f_t = felt(pairs, step).full()
    start = rollers.counts[0]
    count = pairs.gap.shape[0]
    gn, gt = jnp.zeros((count, m)), jnp.zeros((count, m + f))
    for side, given in ((1.0, pairs.between[0]), (-1.0, pairs.between[1])):
        index = jnp.asarray(given, jnp.int32)
        at_travel = jax.nn.one_hot(index, m, dtype=gn.dtype)
        at_spin = jax.nn.one_hot(index - start, f, dtype=gn.dtype)
        along = pairs.nx[:, None] * rollers.dir_x[None, :] + pairs.ny[:, None] * rollers.dir_y[None, :]
        across = pairs.nx[:, None] * rollers.dir_y[None, :] - pairs.ny[:, None] * rollers.dir_x[None, :]
        gn = gn + side * at_travel * along
        gt = gt + jnp.concatenate([side * at_travel * across, -at_spin * rollers.radius[index][:, None]], axis=1)
    rows = jnp.concatenate([jnp.pad(gn, ((0, 0), (0, f))), gt])
    if not step.implicit:
        return jnp.zeros((m + f, m + f)), rows.T @ jnp.concatenate([f_n, f_t])
    weighed = jnp.concatenate([a_n, a_t])[:, None] * rows
    found = rows.T @ jnp.concatenate([weighed, jnp.concatenate([f_n, f_t])[:, None]], axis=1)
    return found[:, :-1], found[:, -1]


def closing_rate(model: Model, bar: int) -> Array:
    """1/s: rate at which a clamp's error decays (Baumgarte).

    The bending frequency of one bar of the sheet: below the fastest that a stable explicit step resolves, whatever the
    units. A rate of the machine is part of the differential equation, so the order of the method is kept: one that grows
    as 1/h makes speeds of order h from the errors of order h^2 that a step or a stage leaves, and no extrapolation takes
    those away. Zero for a sheet without stiffness.
    """
    squared = model.wall_stiffness[bar] / model.bars.inertia[bar]
    stiff = squared > 0.0
    return jnp.where(stiff, jnp.sqrt(jnp.where(stiff, squared, 1.0)), 0.0)  # a root has no slope at zero


def _hold_rows(model: Model, state: State, at: Pose, hold: Hold, step: Step) -> tuple[Array, Array]:
    """Rows of one clamp, (rows, 3, bars) and (rows,): the held point's acceleration is what closes its error.

    Implicit: with the speed of a decay at the end of the step. Explicit: with its acceleration, critically damped.
    """
    k, arm = hold.bar, hold.end * model.bars.half_length[hold.bar]
    c, s, w = at.c[k], at.s[k], at.w[k]
    one, zero = jnp.ones(()), jnp.zeros(())
    rows: dict[str, tuple[Array, ...]] = {
        "x": (one, zero, -arm * s),
        "y": (zero, one, arm * c),
        "heading": (zero, zero, one),
    }
    place = by_direction((at.x[k] + arm * c, at.y[k] + arm * s, state.heading[k]))
    speed = by_direction((at.vx[k] - arm * s * w, at.vy[k] + arm * c * w, w))
    bias = by_direction((arm * w * w * c, arm * w * w * s, zero))
    meant = state.time + step.h if step.implicit else state.time
    target, wanted = by_direction(hold_target(hold, meant)), by_direction(_hold_speed(hold, meant))
    rate = closing_rate(model, k)
    if step.implicit:  # any rate is stable: a limp sheet, which has none of its own, closes half of its error in a step
        rate = jnp.where(rate > 0.0, rate, 1.0 / step.h)
    columns, values = [], []
    for d in hold.rows:
        columns.append(jnp.zeros((3, model.layout.n_bars)).at[:, k].set(jnp.stack(rows[d])))
        error = target[d] - place[d]
        if step.implicit:
            left = (
                error - step.h * wanted[d]
            )  # of which the share of a decay at that rate is closed: nearly all in a long step
            closing = (wanted[d] + rate / (1.0 + step.h * rate) * left - speed[d]) / step.h
        else:
            closing = rate * rate * error + 2.0 * rate * (wanted[d] - speed[d])
        values.append(closing + bias[d])
    return jnp.stack(columns), jnp.stack(values)


def _hold_speed(hold: Hold, time: Array) -> tuple[Array, Array, Array]:
    if hold.path is None:
        zero = jnp.zeros(())
        return zero, zero, zero
    shift = shift_at(hold.path, time)
    return shift.vx, shift.vy, shift.w
