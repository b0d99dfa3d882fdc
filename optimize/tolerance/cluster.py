"""The same study on a Dask cluster: a task is a chunk, and a chunk of a lost worker is run again by another.

Optional: `pip install "diffeed[cluster]"`. Draws are made at home; a worker gets the study in plain values, builds and
compiles it once, and sends back rows.
"""

import functools
import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from diffeed.base.words import short
from optimize.tolerance.problem import ToleranceProblem, packed, unpacked
from optimize.tolerance.run import Evaluator, Rows, chunks
from optimize.tolerance.spread import TOGETHER
from optimize.tolerance.study import Runner

MISSING = 'a cluster needs Dask: pip install "diffeed[cluster]"'
LOSSES = 10
"""Workers that may die over one chunk before it is given up."""


class ClusterError(Exception):
    """There is no cluster to work with."""


@functools.lru_cache(maxsize=4)
def _evaluator(text: str, chunk: int, precise: bool) -> Evaluator:
    """On a worker: the compiled program of a study, kept for the chunks that follow."""
    import jax

    from diffeed import tuning

    jax.config.update("jax_enable_x64", precise)
    tuning.compile_for_many()
    return Evaluator(unpacked(json.loads(text)), chunk)


def run_chunk(text: str, chunk: int, precise: bool, sample: np.ndarray, deviation: np.ndarray) -> Rows:
    """On a worker: rows of a chunk."""
    return _evaluator(text, chunk, precise)(sample, deviation)


def on_cluster(problem: ToleranceProblem, client: Any, chunk: int = TOGETHER) -> Runner:
    """Run samples through a Dask client."""
    import jax
    from dask.distributed import as_completed

    text, precise = json.dumps(packed(problem)), bool(jax.config.values["jax_enable_x64"])

    def run(sample: np.ndarray, deviation: np.ndarray) -> Iterator[Rows]:
        tasks = [
            client.submit(run_chunk, text, chunk, precise, sample[k], deviation[k], pure=False, retries=2)
            for k in chunks(np.arange(len(sample)), chunk)
        ]
        for done in as_completed(tasks):
            try:
                found = done.result()
            except Exception as error:  # of a worker, of the scheduler, of the way there
                told = str(error).strip() or type(error).__name__
                raise ClusterError(
                    f"the cluster gave up: {short(told)}; what was run is kept, --resume goes on"
                ) from error
            yield found
            done.release()

    return run


def connect(scheduler: str | None, workers: int | None) -> Any:
    """A client of the scheduler at an address, or of as many worker processes on this machine."""
    try:
        import dask.config
        from dask.distributed import Client, LocalCluster
    except ImportError:
        raise ClusterError(MISSING) from None
    dask.config.set({"distributed.scheduler.allowed-failures": LOSSES})
    try:
        if scheduler is not None:
            return Client(scheduler, timeout=20)
        return Client(LocalCluster(n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0"))
    except (OSError, ValueError) as error:
        raise ClusterError(f"there is no cluster at {scheduler}: {error}" if scheduler else str(error)) from None
