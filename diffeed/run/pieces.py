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
from diffeed.readings.trajectory import FRAMED, Resume, Trajectory, join
from diffeed.run.examine import prepare
from diffeed.run.progress import begin
from diffeed.run.rollout import STEP, go_on, plan, simulate

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
    shorter: int = 1,
) -> Iterator[Trajectory]:
    """Pieces that `diffeed.readings.trajectory.join` makes one run of: the steps are those of a single `simulate`.
    By the same program so many times `shorter` steps are taken, or a tolerance is as much smaller.

    Ends after the piece in which the run fails. The scene must have passed `diffeed.check`.
    """
    scene = normalise(scene)
    count = count_pieces(frames)
    seconds, inside = scene.duration / count, (frames - 1) // count + 1
    counts = plan(seconds, dt or STEP, inside, scene.crowded)

    def piece_from(resume: Resume) -> Trajectory:
        if tolerance is not None:
            return simulate(
                scene, seconds, dt, inside, method,
                initial=resume, observe=observe, tolerance=tolerance / shorter, most_steps=MOST_STEPS,
            )  # fmt: skip
        made: list[Trajectory] = []
        while len(made) < shorter and (not made or made[-1].ok):
            start = made[-1].final if made else resume
            made.append(go_on(scene, start, seconds / counts.total / shorter, counts, method, observe))
        return _with_frames(join(made), slice(None, None, shorter))

    start = prepare(scene)
    resume = _start(scene, start.model, start.state, tuple(sorted(observe)))
    for _ in range(count):
        piece = piece_from(resume)
        resume = piece.final
        yield jax.block_until_ready(piece)
        if not piece.ok:
            return


def cut_at_failure(trajectory: Trajectory) -> Trajectory:
    """Only frames in which time went on: a failed run stands still at its last good state."""
    time = np.asarray(trajectory.time, dtype=float)
    return _with_frames(trajectory, slice(1 + int(np.argmin(np.append(time[1:] > time[:-1], False)))))


def _with_frames(trajectory: Trajectory, which: slice) -> Trajectory:
    return replace(trajectory, **{name: jax.tree.map(lambda v: v[which], getattr(trajectory, name)) for name in FRAMED})


@jit_of_scene(static_argnames=("observe",))
def _start(scene: Scene, model: Model, state: State, observe: tuple[str, ...]) -> Resume:
    """What a first piece goes on from, so that all are one program."""
    return begin(model, scene, state, observe)
