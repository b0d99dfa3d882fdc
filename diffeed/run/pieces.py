"""A run in pieces of simulated time, one compiled program for all of them: to show how far it is, and to stop early."""

import math
from collections.abc import Iterator

import jax
import numpy as np

from diffeed.base.records import replace
from diffeed.chain.state import State
from diffeed.input.packing import jit_of_scene
from diffeed.input.parts import Scene, normalise
from diffeed.model.arrays import Model
from diffeed.readings.trajectory import FRAMED, Resume, Trajectory
from diffeed.run.examine import prepare
from diffeed.run.progress import begin
from diffeed.run.rollout import simulate

PIECES = 20
MOST_STEPS = 200_000
"""Of one piece, where a tolerance chooses them: a run that asks for more stands still."""


def count_pieces(frames: int) -> int:
    """How many pieces of whole frames: the divisor of the frames' gaps that is nearest to PIECES."""
    gaps = frames - 1
    divisors = [k for k in range(1, math.isqrt(gaps) + 1) if gaps % k == 0]
    return min({*divisors, *(gaps // k for k in divisors)}, key=lambda k: abs(math.log(k / PIECES)))


def run_in_pieces(
    scene: Scene,
    dt: float | None,
    frames: int,
    method: str,
    observe: tuple[str, ...],
    tolerance: float | None = None,
) -> Iterator[Trajectory]:
    """Pieces that `diffeed.readings.trajectory.join` makes one run of: the steps are those of a single `simulate`.

    Ends after the piece in which the run fails. The scene must have passed `diffeed.check`.
    """
    scene = normalise(scene)
    count = count_pieces(frames)
    start = prepare(scene)
    resume = _start(scene, start.model, start.state, tuple(sorted(observe)))
    for _ in range(count):
        piece = simulate(
            scene, scene.duration / count, dt, (frames - 1) // count + 1, method,
            initial=resume, observe=observe, tolerance=tolerance, most_steps=MOST_STEPS,
        )  # fmt: skip
        resume = piece.final
        yield jax.block_until_ready(piece)
        if not piece.ok:
            return


def cut_at_failure(trajectory: Trajectory) -> Trajectory:
    """Only frames in which time went on: a failed run stands still at its last good state."""
    time = np.asarray(trajectory.time, dtype=float)
    count = 1 + int(np.argmin(np.append(time[1:] > time[:-1], False)))
    return replace(
        trajectory, **{name: jax.tree.map(lambda v: v[:count], getattr(trajectory, name)) for name in FRAMED}
    )


@jit_of_scene(static_argnames=("observe",))
def _start(scene: Scene, model: Model, state: State, observe: tuple[str, ...]) -> Resume:
    """What a first piece goes on from, so that all are one program."""
    return begin(model, scene, state, observe)
