"""`check`: every problem of a scene at once, as sentences: its numbers, then its geometry at the start, then the step."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.check_records import check_records
from diffeed.contact_law import BRISTLE_LAG
from diffeed.limits import run_problem, scene_size
from diffeed.model import Model, build
from diffeed.parts import Scene, normalise
from diffeed.rollout import STEP
from diffeed.snapshot import look
from diffeed.state import State, initial_state
from diffeed.statics import settle_model
from diffeed.steppers import DEFAULT, ESTIMATING, EXPLICIT, STEPPERS


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
    method = DEFAULT if method is None else method
    if method not in STEPPERS:
        problems.append(f"method must be one of {', '.join(STEPPERS)}, but is {method!r}")
    if dt is not None and not (np.isfinite(dt) and dt > 0):
        problems.append(f"dt must be > 0 s, but is {dt}")
    if tolerance is not None:
        if not (np.isfinite(tolerance) and tolerance > 0):
            problems.append(f"tolerance must be > 0 mm, but is {tolerance}")
        if method not in ESTIMATING:
            problems.append(f"with a tolerance, method must be one of {', '.join(ESTIMATING)}, but is {method!r}")
    if problems:
        return problems
    scene = normalise(scene)
    if dt is not None or frames is not None:
        longest = None if tolerance is not None else STEP if dt is None else dt
        if problem := run_problem(float(scene.duration), longest, frames, scene_size(scene)):
            return [problem]
    model, before, state, found, now = prepare(scene)
    problems = _deep(model, before, "starts", allowed=0.5)
    if scene.initial == "settled" and not problems:
        if not found:
            problems.append('no rest state was found from which to start; set initial = "given" to start as written')
        problems += _speeds(scene)
        problems += _deep(model, now, "rests", allowed=0.0) if found else []
    if dt is not None and method in EXPLICIT and not problems:
        problems += _too_fast(model, state, dt, method)
    return problems


class Prepared(NamedTuple):
    """A scene ready to run. Gaps between sheets and bodies, (bodies, features), are infinite where nothing can touch."""

    model: Model
    gap_before: Array  # at the start as written
    state: State  # from which the run starts
    found: Array  # bool: settled, or not to be settled
    gap: Array  # at that state


@jax.jit
def prepare(scene: Scene) -> Prepared:
    """A normalised scene, settled if it says so: one program, which `check` and the runs of the command line share."""
    model = build(scene)
    start = initial_state(model, scene)
    state, found = start, jnp.asarray(True)
    if scene.initial == "settled":
        state, found = settle_model(model, start)
    return Prepared(model, _gaps(model, start), state, found, _gaps(model, state))


def _gaps(model: Model, state: State) -> Array:
    pairs = look(model, state)[2].sheets
    return jnp.zeros((0, 0)) if pairs is None else jnp.where(pairs.weight > 0, pairs.gap, jnp.inf)


def _speeds(scene: Scene) -> list[str]:
    return [
        f"sheets.{name}.speed must be 0 mm/s in a scene that starts settled, but is {float(sheet.speed):g};"
        ' set initial = "given" to start in motion'
        for name, sheet in sorted(scene.sheets.items())
        if float(sheet.speed) != 0.0
    ]


def _deep(model: Model, gap: Array, verb: str, allowed: float) -> list[str]:
    """Bars whose axis lies inside a body: penetration beyond half the thickness (plus `allowed` mm, which a start that is
    settled afterwards may have)."""
    half = float(np.min(model.bars.half_thickness))
    found = []
    for name, row in zip(model.body_names, np.asarray(gap), strict=True):
        if np.isfinite(row.min()) and row.min() < -(half + allowed):
            part = f"rollers.{name}" if name in model.rollers.names else f"guides.{name}"
            found.append(
                f"{part}: the sheet {verb} {-row.min():.3g} mm deep in it (bar {int(row.argmin())} of the row); "
                f"it must be less than half the thickness, {half:g} mm"
            )
    return list(dict.fromkeys(found))


def explicit_limit(model: Model, state: State) -> tuple[float, str]:
    """Largest stable step (s) of an explicit method at a state, and the cause: 2.78/omega of bending, contact, damping.

    Estimates: the zig-zag mode of the chain, omega = sqrt(48 k/(m Ls^2)); a bar on its contact spring; dampers 2.78 m/c.
    """
    bars = model.bars
    length = 2.0 * bars.half_length
    bending = float(jnp.max(jnp.sqrt(48.0 * bars.joint_stiffness / (bars.mass * length**2)))) if len(bars.mass) else 0.0
    causes = [(2.78 / max(bending, 1e-30), "bending of the chain")]
    if bending > 0:
        xi = float(
            jnp.max(
                jnp.where(
                    bars.joint_stiffness > 0,
                    bars.joint_damping / jnp.where(bars.joint_stiffness > 0, bars.joint_stiffness, 1.0),
                    0.0,
                )
            )
        )
        causes.append((2.78 / max(xi * bending**2, 1e-30), "structural damping"))
    touching = jax.jit(look)(model, state)[2]
    lightest = float(jnp.min(bars.mass))
    pairs = touching.sheets
    if pairs is not None:
        touch = pairs.touch
        k, c, s = (0.0 if v is None else float(jnp.max(v)) for v in (touch.stiffness, touch.damping, touch.secant))
        # An end circle turns its bar too: a quarter of the mass acts there.
        causes.append((2.78 / max((4.0 * k / lightest) ** 0.5, 1e-30), "contact stiffness"))
        causes.append((2.78 * lightest / max(4.0 * c, 1e-30), "contact damping"))
        causes.append((2.78 * lightest / max(4.0 * s, 1e-30), "friction below the stick speed"))
        if model.surface.stick is not None and touch.secant is not None:
            held = jnp.where(model.surface.stick[:, None], touch.secant, 0.0)
            spring = float(jnp.max(held)) / BRISTLE_LAG
            causes.append((2.78 / max((4.0 * spring / lightest) ** 0.5, 1e-30), "tangential stiffness of what sticks"))
    return min(causes)


def _too_fast(model: Model, state: State, dt: float, method: str) -> list[str]:
    limit, cause = explicit_limit(model, state)
    if dt <= limit:
        return []
    return [
        f"dt must be at most {limit:.2g} s for {method} in this scene ({cause}), but is {dt:g}; {DEFAULT} takes larger steps"
    ]
