"""Random valid scenes, run in batches: no crash, nothing that is not finite, and nothing wrong that says it is right.

Each scene is run with steps of two lengths. Every frame of a run that holds must be sound by plain geometry. Where both
hold and differ (or, asked for, of every run that holds), two runs of order two in steps of microseconds decide: if they agree
with each other, a run that is far from them is wrong; if not, the scene magnifies rounding (sheets that crumple or whirl) and no
run can tell. Error-controlled runs do not decide: their tolerance would have to be far below the depth of a hit, which is
micrometres where a limp sheet meets steel.
"""

import time
import warnings
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import click
import jax
import numpy as np

import diffeed
from diffeed import tuning
from diffeed.faults.causes import CAUSES
from diffeed.input.parts import Scene
from diffeed.readings.agreement import FINER, TOLD
from diffeed.readings.trajectory import Trajectory
from tests.search.machines import DURATION, MACHINES
from tests.search.oracle import complaints

FRAMES = 11
STEPS = {"linear_euler": 2e-4, "extrapolated_euler": 2e-4, "midpoint": 2e-4, "runge_kutta": 5e-5}
"""s: of each method, as a user would take them."""
WRONG, SHARE = 5.0, 0.1
"""mm, and of the longest way that any node made: two runs that agree differ by less than the larger."""
DECIDING = {"method": "midpoint", "dt": 4e-6}
"""Keywords of the finer of the runs that decide; the other takes steps twice as long. `extrapolated_euler` is of order one in the
steps that hit something: in 2e-6 s a hundred times as far off. Held against explicit ones in
tests/test_search.py."""
BATCH, FEW = 64, 8


class Found(NamedTuple):
    """One complaint, with what makes it again."""

    machine: str
    method: str
    seed: int
    what: str
    confirmed: bool = False
    """Whether shorter steps agree with it, to the end."""


class Tally(NamedTuple):
    """What became of the scenes of one structure."""

    machine: str
    method: str
    scenes: int
    refused: int
    held: int
    sensitive: int
    causes: Counter[str]
    found: list[Found]
    seconds: float

    def line(self) -> str:
        failed = ", ".join(f"{n} {cause}" for cause, n in self.causes.most_common() if cause)
        return (
            f"{self.machine}, {self.method}: {self.held} of {self.scenes} hold ({self.refused} more refused by check, "
            f"{self.sensitive} that no run can tell), {len(self.found)} faults, {self.seconds:.0f} s"
            + (f"; failed: {failed}" if failed else "")
        )


def scene_of(machine: str, seed: int) -> Scene:
    """The scene of a structure and a seed, the same on every machine."""
    return MACHINES[machine](np.random.default_rng([seed, *machine.encode()]))


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


def look_for_trouble(machine: str, method: str, count: int, first: int = 0, thorough: bool = False) -> Tally:
    """Run `count` scenes of a structure with steps of two lengths and look at every frame. `thorough`: two that agree may both
    be wrong, so that each is held against the true one."""
    began = time.perf_counter()
    scenes, refused = valid_scenes(machine, first, count)
    held, causes, found, doubted = 0, Counter[str](), [], []
    dt = STEPS[method]
    for batch, real in _batches(scenes, min(BATCH, count)):
        stacked = diffeed.stack([made for _, made in batch])
        coarse, fine = (run_batch(stacked, dt=dt / part, method=method) for part in (1, FINER))
        for i, (seed, made) in enumerate(batch[:real]):
            one, other = sample(coarse, i), sample(fine, i)
            held += bool(one.ok)
            causes[CAUSES[int(one.failure.cause)]] += 1
            found += [Found(machine, method, seed, what) for what in _complaints(made, one, other)]
            if one.ok and other.ok and (thorough or not _agree(one, other)):
                doubted.append((seed, made, one, other))
    sensitive = 0
    for batch, real in _batches(doubted, FEW):
        trues = true_runs(diffeed.stack([made for _, made, *_ in batch]))
        for true, (seed, made, one, other) in zip(trues[:real], batch[:real], strict=True):
            if true is None:
                sensitive += 1
            elif is_wrong(one, true):
                apart, way = _apart(one, true)
                what = f"{apart:.3g} mm off, of {way:.3g} mm moved; it told of {float(one.error):.2g} mm"
                confirmed = diffeed.confirm(made, one, other).to_the_end
                what += ", and is confirmed" * confirmed
                found.append(Found(machine, method, seed, what, confirmed))
    return Tally(machine, method, count, refused, held, sensitive, causes, found, time.perf_counter() - began)


def _batches(rows: list, size: int) -> Iterator[tuple[list, int]]:
    """Rows by the batch and how many are real: the last one is filled up with its first row: one size, one program."""
    for k in range(0, len(rows), size):
        batch = rows[k : k + size]
        yield batch + batch[:1] * (size - len(batch)), len(batch)


def _complaints(scene: Scene, one: Trajectory, other: Trajectory) -> Iterator[str]:
    for name, run in (("", one), (f"with steps {FINER} times shorter, ", other)):
        if run.ok:
            yield from (name + what for what in complaints(scene, run))
        elif int(run.failure.cause) == 0 or not np.isfinite(run.failure.time):
            yield name + "a failed run has no cause or no time"


def _apart(one: Trajectory, other: Trajectory) -> tuple[float, float]:
    """Largest distance of any node at any frame, and the longest way of any node, mm."""
    apart = max(np.abs(one.sheets[name].nodes - other.sheets[name].nodes).max() for name in one.sheets)
    return apart, max(np.abs(np.diff(track.nodes, axis=0)).sum(axis=0).max() for track in other.sheets.values())


def _agree(one: Trajectory, other: Trajectory) -> bool:
    apart, way = _apart(one, other)
    return bool(apart <= max(WRONG, SHARE * way))


def true_runs(stacked: Scene) -> list[Trajectory | None]:
    """What becomes of each scene; None where no run can tell."""
    rough, fine = (run_batch(stacked, **(DECIDING | {"dt": part * DECIDING["dt"]})) for part in (2, 1))
    pairs = [(sample(rough, i), sample(fine, i)) for i in range(len(fine.ok))]
    return [b if a.ok and b.ok and _agree(a, b) else None for a, b in pairs]


def is_wrong(one: Trajectory, true: Trajectory) -> bool:
    """Whether a run is far from the true one, and further than it tells."""
    return not _agree(one, true) and bool(_apart(one, true)[0] > TOLD * float(one.error))


def run_batch(stacked: Scene, **options: object) -> Trajectory:
    def run(scene: Scene) -> Trajectory:
        return diffeed.simulate(scene, duration=DURATION, frames=FRAMES, **options)  # type: ignore[arg-type]

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", diffeed.SinglePrecision)
        return jax.device_get(jax.vmap(run)(stacked))


def sample(batch: Trajectory, i: int) -> Trajectory:
    return jax.tree.map(lambda v: v[i], batch)


@click.command()
@click.option("--count", default=10_000, show_default=True, help="Scenes in all, shared by structures and methods.")
@click.option("--first", default=0, show_default=True, help="Seed of the first scene of each structure.")
@click.option("--machines", default=",".join(MACHINES), help="Structures, by commas; all by default.")
@click.option("--methods", default="", help="Methods, by commas; by default each structure has two in turn.")
@click.option("--thorough", is_flag=True, help="Hold every run against a true one, not only those that differ.")
def command(count: int, first: int, machines: str, methods: str, thorough: bool) -> None:
    """Run random valid scenes and look for runs that are wrong though they say that they hold."""
    jax.config.update("jax_enable_x64", True)
    tuning.compile_quickly()
    names = machines.split(",")
    if unknown := sorted(set(names) - set(MACHINES)):
        raise click.BadParameter(f"{', '.join(unknown)}: there are {', '.join(MACHINES)}", param_hint="--machines")
    turns = [(name, method) for k, name in enumerate(names) for method in (methods.split(",") if methods else _turn(k))]
    each = -(-count // len(turns))
    tallies = []
    for name, method in turns:
        tallies.append(look_for_trouble(name, method, each, first, thorough))
        click.echo(tallies[-1].line())
        for fault in tallies[-1].found:
            click.echo(f"    seed {fault.seed}: {fault.what}")
    faults = sum(len(t.found) for t in tallies)
    scenes, held, told = (sum(getattr(t, name) for t in tallies) for name in ("scenes", "held", "sensitive"))
    confirmed = sum(fault.confirmed for t in tallies for fault in t.found)
    click.echo(
        f"{scenes} scenes, {held} hold, {told} that no run can tell, {faults} faults, {confirmed} of them confirmed by "
        "shorter steps"
    )
    raise SystemExit(1 if faults else 0)


def _turn(k: int) -> tuple[str, str]:
    """Two methods for the k-th structure; all of them have their turn."""
    others = ("extrapolated_euler", "midpoint", "runge_kutta")
    return "linear_euler", others[k % len(others)]
