"""A tolerance study from its draws to its rows: in this process or on a cluster, with or without a folder."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from optimize.programs import kept
from optimize.tolerance.draws import deviations, uniforms
from optimize.tolerance.folder import Folder
from optimize.tolerance.problem import ToleranceProblem
from optimize.tolerance.run import Evaluator, Rows, bytes_of, chosen, chunks, joined
from optimize.tolerance.spread import chunk_size

Show = Callable[[int, int, int], None]
"""Told after every chunk: samples done in all, how many of these did not pass, samples run just now."""
Runner = Callable[[np.ndarray, np.ndarray], Iterator[Rows]]
"""From indices (n,) and deviations (n, inputs) to rows, chunk by chunk, in any order."""


def here(problem: ToleranceProblem, chunk: int | None = None) -> Runner:
    """Run samples in this process."""

    def run(sample: np.ndarray, deviation: np.ndarray) -> Iterator[Rows]:
        size = chunk or chunk_size(lambda: bytes_of(problem), len(sample))
        evaluate = kept(("samples", problem.key, size), lambda: Evaluator(problem, size))
        for picked in chunks(np.arange(len(sample)), evaluate.chunk):
            yield evaluate(sample[picked], deviation[picked])

    return run


def drawn(problem: ToleranceProblem) -> np.ndarray:
    """(samples, inputs) the deviations of all samples."""
    study = problem.study
    return deviations(problem.inputs, uniforms(problem.inputs, study.sampling, study.samples, study.seed))


def run_study(
    problem: ToleranceProblem,
    runner: Runner | None = None,
    out: Path | None = None,
    resume: bool = False,
    force: bool = False,
    show: Show | None = None,
) -> Rows:
    """All samples of a study, in their order. With `out`, rows are on disk as they come and `resume` goes on with them."""
    return run_rows(problem, drawn(problem), runner, Folder(out, problem) if out else None, resume, force, show)


def run_rows(
    problem: ToleranceProblem,
    deviation: np.ndarray,
    runner: Runner | None = None,
    folder: Folder | None = None,
    resume: bool = False,
    force: bool = False,
    show: Show | None = None,
) -> Rows:
    """Rows for deviations (n, inputs), those in the folder not run again; rows beyond them stay in it. Raises FolderError
    before anything is run."""
    done = folder.start(resume, force) if folder else None
    parts: list[Rows] = []
    spare: list[Rows] = []
    if done is not None:
        known = done.sample < len(deviation)
        spare.append(chosen(done, ~known))  # of a study that asked for more: they stay, and may be asked for again
        # Only rows of the very numbers that are asked for: other runs of indices number theirs alike.
        known[known] = (done.deviation[known] == deviation[done.sample[known]]).all(axis=1)
        usable = chosen(done, known)
        _, first = np.unique(usable.sample, return_index=True)
        parts.append(chosen(usable, first))
    there = parts[0].sample if parts else np.zeros(0, int)
    left = np.setdiff1d(np.arange(len(deviation)), there)
    total, failed = len(there), int(np.sum(~parts[0].passed)) if parts else 0
    try:
        if len(left):
            for rows in (runner or here(problem))(left, deviation[left]):
                parts.append(rows)
                if folder:
                    folder.add(rows)
                total, failed = total + len(rows.sample), failed + int(np.sum(~rows.passed))
                if show:
                    show(total, failed, len(rows.sample))
        whole = joined(parts)
        if folder:
            folder.sort(joined([whole, *spare]))
    finally:
        if folder:
            folder.close()
    return whole
