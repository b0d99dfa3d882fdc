"""`check`: every problem of a scene at once, as sentences: its numbers, then its geometry at the start, then the step."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree

from diffeed.base.limits import run_problem, scene_size
from diffeed.base.records import replace
from diffeed.chain.state import State, initial_state
from diffeed.contact.crossing import Misplaced, misplaced
from diffeed.contact.kept import allowed_depths, keep_all
from diffeed.input.check_records import check_records
from diffeed.input.check_values import measure, show
from diffeed.input.packing import jit_of_scene
from diffeed.input.parts import Scene, normalise
from diffeed.model.arrays import Model
from diffeed.model.build import build
from diffeed.pair.law import BRISTLE_LAG
from diffeed.readings.snapshot import look
from diffeed.run.joints import IN_FRONT, opposed
from diffeed.run.rollout import STEP
from diffeed.statics.rest import settle_model
from diffeed.steppers import DEFAULT, ESTIMATING, EXPLICIT, STEPPERS, midpoint, runge_kutta


def check(
    scene: Scene,
    dt: float | None = None,
    method: str | None = None,
    tolerance: float | None = None,
    frames: int | None = None,
) -> list[str]:
    """Every problem of a scene, each naming its part and field, the value and what it must be; empty if it is sound.

    With `dt` (s), `method` or `tolerance` (mm), also whether the method can take such steps; with `frames`, also whether a
    run of the scene's duration that keeps so many is of a size that can be run.
    """
    problems = check_records(scene)
    meant = not (dt is None and frames is None and method is None)  # a run of equal steps, if no tolerance is given
    method = DEFAULT if method is None else method
    if method not in STEPPERS:
        problems.append(f"method must be one of {', '.join(STEPPERS)}, but is {method!r}")
    for name, value, of in (("dt", dt, "s"), ("tolerance", tolerance, "mm")):
        given = measure(value)
        sure = given is not None and given.shape == () and given.entries is not None and 0.0 < given.entries < np.inf
        if value is not None and not sure:
            problems.append(f"{name} must be > 0 {of}, but is {show(value)}")
    if tolerance is not None and method not in ESTIMATING:
        problems.append(f"with a tolerance, method must be one of {', '.join(ESTIMATING)}, but is {method!r}")
    if problems:
        return problems
    scene = normalise(scene)
    if dt is not None or frames is not None:
        longest = None if tolerance is not None else STEP if dt is None else dt
        if problem := run_problem(float(scene.duration), longest, frames, scene_size(scene)):
            return [problem]
    model, before, state, found, now, wrong = prepare(scene)
    problems = [*opposed(scene), *_deep(model, before, "starts", allowed=0.5 if scene.initial == "settled" else 0.0)]
    in_front = f"sheets must start in front of guides ({IN_FRONT})"
    problems += [f"{part}: a bar lies across it at the start; {in_front}" for part in _guides(model, wrong.across)]
    problems += [
        f"{part}: a bar lies behind its face at the start; {in_front}" for part in _guides(model, wrong.behind)
    ]
    if scene.initial == "settled" and not problems:
        if not found:
            problems.append(
                "no rest state was found from which to start: look for a sheet or a pinch that nothing stops, for clamps that"
                " hold one thing twice, and for a mass, stiffness, curl or size in the wrong unit;"
                ' initial = "given" starts as written'
            )
        problems += _speeds(scene)
        problems += _deep(model, now, "rests", allowed=0.5 * np.asarray(allowed_depths(model))) if found else []
    if meant and method in EXPLICIT and not problems:
        problems += _too_fast(model, state, STEP if dt is None else dt, method)
    return problems


def _guides(model: Model, chosen: Array) -> list[str]:
    """Parts, of (guides,) bool."""
    return [f"guides.{name}" for name in np.array(model.guides.names)[np.asarray(chosen)]]


class Prepared(NamedTuple):
    """A scene ready to run. Gaps between sheets and bodies, (bodies, features), are infinite where nothing can touch."""

    model: Model
    gap_before: Array  # at the start as written
    state: State  # from which the run starts
    found: Array  # bool: settled, or not to be settled
    gap: Array  # at that state
    misplaced: Misplaced  # at the start as written


@jit_of_scene
def prepare(scene: Scene) -> Prepared:
    """A normalised scene, settled if it says so: one program, which `check` and the runs of the command line share."""
    model = build(scene)
    start = initial_state(model, scene)
    state, found = start, jnp.asarray(True)
    if scene.initial == "settled":
        state, found = settle_model(model, start)
    return Prepared(model, _gaps(model, start), state, found, _gaps(model, state), misplaced(model, start))


def _gaps(model: Model, state: State) -> Array:
    pairs = look(model, state)[2].sheets
    return jnp.zeros((0, 0)) if pairs is None else jnp.where(pairs.weight > 0, pairs.gap, jnp.inf)


STARTS = (
    ("sheets", "speed", "mm/s"),
    ("sheets", "velocity", "mm/s"),
    ("sheets", "rates", "rad/s"),
    ("rollers", "spin", "rad/s"),
)
"""What sets parts going at the start: section, field, unit."""


def _speeds(scene: Scene) -> list[str]:
    found = []
    for section, field, unit in STARTS:
        for name, part in sorted(getattr(scene, section).items()):
            value = _start_of(part, field)
            if np.any(value != 0.0):
                shown = show(value.tolist()) if value.ndim else f"{value:g}"
                found.append(
                    f"{section}.{name}.{field} must be 0 {unit} in a scene that starts settled, but is {shown};"
                    ' set initial = "given" to start in motion'
                )
    return found


def _start_of(part: Any, field: str) -> np.ndarray:
    """What a part has there, zero if it has nothing."""
    value = getattr(part, field, None)
    return np.zeros(()) if value is None else np.asarray(value)


def _deep(model: Model, gap: Array, verb: str, allowed: float | np.ndarray) -> list[str]:
    """Bars whose axis lies inside a body: penetration beyond half the thickness, plus `allowed` mm, (bodies,) or one for all: of
    a start that is settled afterwards, or what a soft contact may give way at rest."""
    if not gap.size:
        return []
    layout, half = model.layout, model.bars.half_thickness
    halves, found = np.asarray(half)[layout.bar_of_feature], []
    deepest = np.broadcast_to(allowed, (len(model.body_names),))
    for index, (name, row) in enumerate(zip(model.body_names, np.asarray(gap), strict=True)):
        part = f"{'rollers' if index < model.rollers.n else 'guides'}.{name}"
        for k, sheet in enumerate(layout.names):
            mine = layout.sheet_of_feature[:, k]
            beyond = row[mine] + halves[mine]
            worst = int(beyond.argmin())
            if np.isfinite(beyond[worst]) and beyond[worst] < -deepest[index]:
                where = f"bar {worst}" if worst < layout.bars[k] else "tail"
                limit = f"half the thickness, {halves[mine][worst]:g} mm"
                if verb == "rests":
                    limit = f"{halves[mine][worst] + deepest[index]:.3g} mm: a stiffer contact or less force"
                found.append(
                    f"{part}: sheet {sheet} {verb} {-row[mine][worst]:.3g} mm deep in it ({where}); it must be less than {limit}"
                )
    return list(dict.fromkeys(found))


def explicit_limit(model: Model, state: State) -> tuple[float, str]:
    """Largest stable step (s) of `runge_kutta`, and which spring or damper is the likeliest cause.

    The smaller of two. From the eigenvalues of the equations of motion at a state, everything standing still: there
    friction is at its stiffest. And of an end of the sheet in a nip: that comes later, and not every contact is at its full
    stiffness at the start. What presses deeper later, with an exponent other than 1 or with dampers, is not seen.
    """
    model = _undriven(model)
    stiffest, at_an_end = _estimates(model, _still(state))
    rates = np.linalg.eigvals(np.asarray(_slopes(model, state)))
    return _largest_step(np.concatenate([rates, at_an_end])), stiffest


def _undriven(model: Model) -> Model:
    """With shafts that do not turn."""
    drives = (replace(d, values=jnp.zeros_like(d.values)) for d in model.rollers.drives)
    return replace(model, rollers=replace(model.rollers, drives=tuple(drives)))


def _still(state: State) -> State:
    return replace(state, **{name: jnp.zeros_like(getattr(state, name)) for name in midpoint.RATES})


@jax.jit
def _slopes(model: Model, state: State) -> Array:
    """Derivative of the rate of change of a state by the state, all speeds zero."""
    flat, whole = ravel_pytree(_still(state))
    kept = keep_all(model)
    return jax.jacfwd(lambda v: ravel_pytree(runge_kutta.derivative(model, whole(v), jnp.ones(()), kept)[0])[0])(flat)


def _largest_step(rates: Any) -> float:
    """Largest h for which classical Runge-Kutta lets no mode exp(rate t) grow; infinite where nothing moves by itself.

    A mode that grows by itself (a sheet that buckles) counts as one that decays as fast.
    """
    size = np.abs(rates)
    fast = rates[size > 1e-6 * max(np.max(size, initial=0.0), 1e-30)]
    if not len(fast):
        return np.inf
    radius = np.linspace(0.5, 4.0, 3501)[:, None]
    z = radius * (-np.abs(fast.real) + 1j * fast.imag)[None, :] / np.abs(fast)[None, :]
    growth = np.abs(1.0 + z * (1.0 + z / 2.0 * (1.0 + z / 3.0 * (1.0 + z / 4.0))))
    return float(np.min(radius[np.argmax(growth > 1.0 + 1e-9, axis=0) - 1, 0] / np.abs(fast)))


def _estimates(model: Model, state: State) -> tuple[str, np.ndarray]:
    """The spring or damper whose own rate (1/s) is the largest, and the rates of an end of the sheet in a nip.

    Bending: the zig-zag mode of a chain, omega = sqrt(48 k/(m L^2)), its damping xi omega^2. Contact: the end of a long chain
    of bars without stiffness moves under a force like m/(2 sqrt 3), and a nip presses from both sides.
    """
    bars = model.bars
    bending = jnp.sqrt(48.0 * bars.joint_stiffness / bars.mass) / (2.0 * bars.half_length)
    bent = jnp.where(bars.joint_stiffness > 0, bars.joint_stiffness, 1.0)
    rates = {
        "bending of the chain": float(jnp.max(bending)),
        "structural damping": float(jnp.max(bars.joint_damping / bent * bending**2)),
    }
    pairs = jax.jit(look)(model, state)[2].sheets
    if pairs is None:
        return max(rates, key=lambda name: rates[name]), np.zeros(0)
    touch, surface = pairs.touch, model.surface
    moved = float(jnp.min(bars.mass)) / (4.0 * 3.0**0.5)
    full = float(jnp.max(jnp.where(surface.exponent == 1.0, surface.stiffness, 0.0)))
    now, c, s = (0.0 if v is None else float(jnp.max(v)) for v in (touch.stiffness, touch.damping, touch.secant))
    spring, damper = (max(full, now) / moved) ** 0.5, c / moved
    rates |= {"contact stiffness": spring, "contact damping": damper, "friction below the stick speed": s / moved}
    if surface.stick is not None and touch.secant is not None:
        held = float(jnp.max(jnp.where(surface.stick[:, None], touch.secant, 0.0)))
        rates["tangential stiffness of what sticks"] = (held / BRISTLE_LAG / moved) ** 0.5
    return max(rates, key=lambda name: rates[name]), np.roots([1.0, damper, spring**2])


def _too_fast(model: Model, state: State, dt: float, method: str) -> list[str]:
    limit, cause = explicit_limit(model, state)
    if dt <= limit:
        return []
    return [
        f"dt must be at most {limit:.2g} s for {method} in this scene ({cause}), but is {dt:g}; {DEFAULT} takes larger steps"
    ]
