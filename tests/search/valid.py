"""Random valid scenes, run in batches: no crash, nothing that is not finite, and nothing wrong that says it is right."""

import time
import warnings
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np

import diffeed
from diffeed.causes import CAUSES
from diffeed.parts import Scene
from diffeed.trajectory import Trajectory
from tests.search.machines import MACHINES
from tests.search.oracle import complaints

FRAMES = 11
STEPS = {"linear_euler": 2e-4, "extrapolated_euler": 5e-4, "midpoint": 2e-4, "runge_kutta": 5e-5}
"""s: of each method, as a user would take them."""
FINER = 4
"""Times shorter are the steps that each run is compared with."""
WRONG, SHARE = 5.0, 0.1
"""mm, and of the longest way that any node made: two runs that hold must not differ by more than both."""
BATCH = 128


class Found(NamedTuple):
    """One complaint, with what makes it again."""

    machine: str
    method: str
    seed: int
    what: str


class Tally(NamedTuple):
    """What became of the scenes of one structure."""

    machine: str
    method: str
    scenes: int
    refused: int
    held: int
    causes: Counter[str]
    found: list[Found]
    seconds: float


def scene_of(machine: str, seed: int) -> Scene:
    """The scene of a structure and a seed, the same on every machine."""
    return MACHINES[machine].draw(np.random.default_rng([seed, *machine.encode()]))


def valid_scenes(machine: str, first: int, count: int) -> tuple[list[tuple[int, Scene]], int]:
    """`count` scenes that `check` passes, by seed, and how many it refused on the way."""
    found, refused, seed = [], 0, first
    while len(found) < count:
        made = scene_of(machine, seed)
        if diffeed.check(made):
            refused += 1
        else:
            found.append((seed, made))
        seed += 1
    return found, refused


def look_for_trouble(machine: str, method: str, count: int, first: int = 0) -> Tally:
    """Run `count` scenes of a structure with steps of two lengths and look at every frame."""
    began = time.perf_counter()
    scenes, refused = valid_scenes(machine, first, count)
    held, causes, found = 0, Counter[str](), []
    for k in range(0, len(scenes), BATCH):
        batch = scenes[k : k + BATCH]
        padded = batch + batch[:1] * (min(BATCH, count) - len(batch))  # one size, one program
        stacked = diffeed.stack([made for _, made in padded])
        coarse, fine = (_run(stacked, machine, method, STEPS[method] / part) for part in (1, FINER))
        for i, (seed, made) in enumerate(batch):
            one, other = _sample(coarse, i), _sample(fine, i)
            held += bool(one.ok)
            causes[CAUSES[int(one.failure.cause)]] += 1
            found += [Found(machine, method, seed, what) for what in _complaints(made, one, other)]
    return Tally(machine, method, count, refused, held, causes, found, time.perf_counter() - began)


def _complaints(scene: Scene, one: Trajectory, other: Trajectory) -> Iterator[str]:
    for name, run in (("", one), (f"with steps {FINER} times shorter, ", other)):
        if run.ok:
            yield from (name + what for what in complaints(scene, run))
        elif int(run.failure.cause) == 0 or not np.isfinite(run.failure.time):
            yield name + "a failed run has no cause or no time"
    if one.ok and other.ok:
        apart = max(np.abs(one.sheets[name].nodes - other.sheets[name].nodes).max() for name in one.sheets)
        way = max(np.abs(np.diff(track.nodes, axis=0)).sum(axis=0).max() for track in other.sheets.values())
        if not apart <= max(WRONG, SHARE * way):
            yield f"{apart:.3g} mm from the run with steps {FINER} times shorter, of {way:.3g} mm moved"


def _run(stacked: Scene, machine: str, method: str, dt: float) -> Trajectory:
    duration = MACHINES[machine].duration

    def run(scene: Scene) -> Trajectory:
        return diffeed.simulate(scene, duration=duration, dt=dt, frames=FRAMES, method=method)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", diffeed.SinglePrecision)
        return jax.device_get(jax.vmap(run)(stacked))


def _sample(batch: Trajectory, i: int) -> Trajectory:
    return jax.tree.map(lambda v: v[i], batch)
