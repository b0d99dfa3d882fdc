"""What the checks of a run cost: `python -m tests.checks_cost [SCENE] [DT]`, in turns with a run without any, in one process."""

import functools
import sys
import time
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np

import diffeed
from diffeed import tuning
from diffeed.faults import balance, judge, rebounds
from diffeed.input.parts import normalise
from diffeed.run import progress
from diffeed.run.examine import prepare

TURNS = 151


def without_checks():
    """The library with nothing looked for in a step or a block; the search's own completeness stays."""
    none = (jnp.zeros((), jnp.int32), jnp.zeros(()))
    return (
        mock.patch.object(judge, "of_step", return_value=none),
        mock.patch.object(balance, "is_kept", return_value=False),
        mock.patch.object(rebounds, "judged", side_effect=lambda model, before, *_: (before, jnp.zeros((), bool))),
        mock.patch.object(progress, "_misplaced", return_value=jnp.zeros((), jnp.int32)),
    )


def main(where: str = "film_feeder", dt: str = "1e-4") -> None:
    jax.config.update("jax_enable_x64", True)
    tuning.compile_for_speed()
    tuning.use_one_core()  # as the command line does
    scene = normalise(diffeed.load_scene(where))
    start = prepare(scene).state  # settling is no part of a step

    def compiled():
        jax.clear_caches()
        run = jax.jit(functools.partial(diffeed.simulate, duration=0.1, dt=float(dt), frames=11, initial=start))
        return run.lower(scene).compile()

    programs = {"with": compiled()}
    patches = without_checks()
    for patch in patches:
        patch.start()
    programs["without"] = compiled()
    for patch in patches:
        patch.stop()

    spent = {name: [] for name in programs}
    for _ in range(TURNS):
        for name, program in programs.items():
            began = time.perf_counter()
            found = jax.block_until_ready(program(scene))
            spent[name].append((time.perf_counter() - began) / int(found.steps))
    medians = {name: 1e6 * float(np.median(values)) for name, values in spent.items()}
    ratio = np.median(np.array(spent["with"]) / np.array(spent["without"]))
    print(f"{where}: {medians['with']:.1f} us a step with checks, {medians['without']:.1f} without; ratio {ratio:.3f}")


if __name__ == "__main__":
    main(*sys.argv[1:])
