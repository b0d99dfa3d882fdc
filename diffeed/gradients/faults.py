"""Where a gradient stops being finite: the first step, the pair and the term whose derivative is not a number.

Reverse mode is what breaks: a branch that is not taken still sends 0 times infinity back. So every step is pulled back by
itself with an arbitrary cotangent, and in the first that answers with NaN, every pair and term.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from diffeed.chain.state import State
from diffeed.contact.kept import keep_all
from diffeed.contact.sweep import Pairs
from diffeed.forces.assemble import assemble
from diffeed.forces.terms import Step as ForceStep
from diffeed.input.check_records import checked
from diffeed.input.parts import Scene
from diffeed.input.paths import numbers
from diffeed.model.arrays import Model
from diffeed.model.build import build
from diffeed.readings.snapshot import look
from diffeed.run.progress import begin
from diffeed.run.rollout import plan, refuse
from diffeed.steppers import DEFAULT, EXPLICIT, STEPPERS

GEOMETRY = ("gap", "nx", "ny", "weight", "v_n", "v_t")
LAW = ("force", "stiffness", "damping", "friction", "secant")


class BadStep(NamedTuple):
    """The first step whose derivative is not finite; step -1: there is none."""

    step: int
    time: float
    part: str  # the body of the pair
    feature: str  # the bar or end circle of the sheet (of the smooth skin: the piece at the bar's front node)
    term: str
    numbers: tuple[str, ...]  # numbers of the scene whose derivative is not finite

    def sentence(self) -> str:
        if self.step < 0:
            return "every step has finite derivatives"
        pair = f", between {self.part} and {self.feature}" if self.part else ""
        what = f"; numbers concerned: {', '.join(self.numbers[:6])}" if self.numbers else ""
        if self.step == 0:
            return f"the derivative of the start (settling) is not finite{what}"
        return f"step {self.step}, at {self.time:.6g} s{pair}: the derivative of the {self.term} is not finite{what}"


def explain_gradient(scene: Scene, duration: float | None = None, dt: float = 1e-4, method: str = DEFAULT) -> BadStep:
    """Find the first step of a run whose derivative is not finite, and in it the pair and the term.

    Costs some three runs and one stored state per step. Raises SceneError for numbers that no scene can have,
    ValueError for another argument that makes no sense.
    """
    scene = checked(scene)
    duration = scene.duration if duration is None else duration
    refuse(duration, dt, 2, method, ())
    steps = plan(duration, dt, 2, scene.crowded).total
    states, bad, start = _walk(scene, duration / steps, steps, method)
    found = np.flatnonzero(np.asarray(bad))
    if not len(found):
        broken = () if _finite(start) else _broken(start)
        return BadStep(0 if broken else -1, 0.0, "", "", "", broken)
    k = int(found[0])
    state = jax.tree.map(lambda v: v[k], states)
    time = float(state.time) + duration / steps
    return BadStep(
        k + 1, time, *_blame(scene, state, duration / steps, method), _numbers(scene, state, duration / steps, method)
    )


def _pull(scene: Scene, state: State, h: Any, method: str) -> tuple[Scene, State]:
    """Cotangents of scene and state for an arbitrary cotangent of the next state."""

    def step(scene: Scene, state: State) -> State:
        model = build(scene)
        return STEPPERS[method](model, state, jnp.asarray(h, state.time.dtype), keep_all(model))[0]

    after, pull = jax.vjp(step, scene, state)
    return pull(jax.tree.map(jnp.ones_like, after))


def _finite(tree: Any) -> Array:
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(v)) for v in jax.tree.leaves(tree)]))


def _walk(scene: Scene, h: float, steps: int, method: str) -> tuple[State, Array, Any]:
    def run(scene: Scene) -> tuple[State, Array, Any]:
        def first_state(scene: Scene) -> State:
            return begin(build(scene), scene, None, ()).state

        first, pull = jax.vjp(first_state, scene)
        (start,) = pull(jax.tree.map(jnp.ones_like, first))
        model = build(scene)

        def one(state: State, _: None) -> tuple[State, tuple[State, Array]]:
            after, _touching = STEPPERS[method](model, state, jnp.asarray(h, state.time.dtype), keep_all(model))
            return after, (state, ~_finite(_pull(scene, state, h, method)))

        _, (states, bad) = lax.scan(one, first, None, length=steps)
        return states, bad, start

    return jax.jit(run)(scene)


def _broken(gradient: Scene) -> tuple[str, ...]:
    return tuple(path for path, value in numbers(gradient).items() if not np.all(np.isfinite(np.asarray(value))))


def _numbers(scene: Scene, state: State, h: float, method: str) -> tuple[str, ...]:
    return _broken(jax.jit(lambda s, x: _pull(s, x, h, method)[0])(scene, state))


def _blame(scene: Scene, state: State, h: float, method: str) -> tuple[str, str, str]:
    """(part, feature, term) of the first derivative that is not finite, in the order in which a step is computed."""
    model = build(scene)
    if model.has_bodies:
        for term, pairs in jax.jit(_bad_pairs)(scene, state).items():
            found = np.argwhere(np.asarray(pairs))
            if len(found):
                return (*_names(model, *map(int, found[0])), term)
    system = jax.jit(lambda s, x: _system_is_fine(s, x, h, method not in EXPLICIT))(scene, state)
    return "", "", "solution of the step" if bool(system) else "forces outside contacts"


def _bad_pairs(scene: Scene, state: State) -> dict[str, Array]:
    """Per term, (bodies, features) bool: the derivative with respect to state or scene is not finite.

    Each term by itself: pulled back together, a bad one would spoil the others by zero times infinity.
    """

    def pairs_of(scene: Scene, state: State) -> Pairs:
        pairs = look(build(scene), state)[2].sheets
        assert pairs is not None
        return pairs

    shape = pairs_of(scene, state).gap.shape

    def term(name: str) -> Callable[[Scene, State], Array]:
        def value(scene: Scene, state: State) -> Array:
            pairs = pairs_of(scene, state)
            found = getattr(pairs if name in GEOMETRY else pairs.touch, name)
            return jnp.broadcast_to(
                jnp.zeros(()) if found is None else found, shape
            )  # None: the scene has no such term

        return value

    return {_meaning(n): _any_bad(jax.jacrev(term(n), argnums=(0, 1))(scene, state), shape) for n in (*GEOMETRY, *LAW)}


def _meaning(name: str) -> str:
    if name in ("v_n", "v_t"):
        return f"relative speed {name}"
    return name if name in GEOMETRY else f"contact law: {name}"


def _any_bad(slopes: Any, shape: tuple[int, ...]) -> Array:
    bad = [jnp.any(~jnp.isfinite(v.reshape(*shape, -1)), axis=-1) for v in jax.tree.leaves(slopes)]
    return jnp.any(jnp.stack(bad), axis=0)


def _system_is_fine(scene: Scene, state: State, h: float, implicit: bool) -> Array:
    def system(scene: Scene, state: State) -> Any:
        model = build(scene)
        return assemble(model, state, ForceStep(jnp.asarray(h, state.time.dtype), implicit), keep_all(model))[0]

    made, pull = jax.vjp(system, scene, state)
    return _finite(pull(jax.tree.map(jnp.ones_like, made)))


def _names(model: Model, body: int, feature: int) -> tuple[str, str]:
    bodies = model.body_names
    layout = model.layout
    names = [
        f"{s}, bar {k}" if k < n else f"{s}, tail"
        for s, n in zip(layout.names, layout.bars, strict=True)
        for k in range(n + 1)
    ]
    return bodies[body], names[feature]
