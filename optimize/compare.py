"""How many simulations the gradient saves: the same objective for the gradient, differential evolution and Nelder-Mead.

All three see one number: the objective with broken limits punished by the study's penalty. A gradient counts as its
measured cost in forward runs.
"""

import json
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from diffeed import plot_style
from diffeed.base.files import plain, write_whole
from optimize.descent import Progress, begin, search
from optimize.evaluate import Evaluator
from optimize.problem import Problem, Settings, loss

if TYPE_CHECKING:
    from matplotlib.axes import Axes


CLOSE = 0.02
"""Share of its value by which another search may miss what the gradient found."""


class Trace(NamedTuple):
    """Best merit so far against cost in forward runs."""

    name: str
    cost: np.ndarray
    best: np.ndarray


class Comparison(NamedTuple):
    """`ratio`: cost of a value with its gradient, in forward runs of the same batch size one."""

    traces: list[Trace]
    target: float
    ratio: float
    variables: int


class _Enough(Exception):
    pass


def merit(problem: Problem) -> Callable[[np.ndarray], float]:
    """The punished objective of a unit point, nothing eased; infinity where the run fails."""
    none = jnp.zeros((len(problem.media), problem.sides))
    penalty = jnp.asarray(problem.study.search.penalty)

    def of(unit: Any) -> Any:
        value, seen = loss(problem, unit, none, penalty, Settings())
        return jnp.where(jnp.all(seen.ok) & jnp.isfinite(value), value, jnp.inf)

    compiled = jax.jit(of)
    return lambda unit: float(compiled(jnp.asarray(np.clip(unit, 0.0, 1.0))))


def cost_of_gradient(problem: Problem) -> float:
    """Time of a value with gradient over that of a value, both compiled, one point: the median of runs in turn."""
    none = np.zeros((1, len(problem.media), problem.sides))
    evaluator, plain = Evaluator(problem), merit(problem)
    unit = problem.start[None]

    def spent(function: Callable[[], Any]) -> float:
        begun = time.perf_counter()
        function()
        return time.perf_counter() - begun

    def whole() -> Any:
        return evaluator.gradients(unit, none, np.full(1, problem.study.search.penalty), Settings())

    ratios = [spent(whole) / spent(lambda: plain(problem.start)) for _ in range(1 + 5)]
    return float(np.median(ratios[1:]))  # the first of each compiles


def compare(problem: Problem, budget: int, say: Callable[[str], None] = lambda text: None) -> Comparison:
    """Run the three searches, each up to `budget` forward runs. The target is what the gradient found, within `CLOSE`."""
    ratio = cost_of_gradient(problem)
    say(f"a value with its gradient costs {ratio:.1f} forward runs")
    of = merit(problem)
    at_start = of(problem.start)
    traces = [_gradient(problem, of, ratio, budget, at_start)]
    say(f"gradient: {traces[0].best[-1]:.5g} after {traces[0].cost[-1]:.0f} forward runs, from {at_start:.5g}")
    for name, run in (("differential evolution", _evolution), ("Nelder-Mead", _simplex)):
        traces.append(_traced(name, of, run, problem, budget, at_start))
        say(f"{name}: {traces[-1].best[-1]:.5g} after {traces[-1].cost[-1]:.0f} forward runs")
    found = traces[0].best[-1]
    return Comparison(traces, float(found + CLOSE * abs(found)), ratio, len(problem.names))


def _gradient(problem: Problem, of: Callable[[np.ndarray], float], ratio: float, budget: int, at_start: float) -> Trace:
    cost, best = [1.0], [at_start]
    progress: Progress = begin(problem)
    # Gradients in what `ratio` is the cost of: those of one point, its draws, media and machines.
    point = len(Evaluator(problem).draws) * len(problem.media) * len(problem.deviations())
    for _ in search(problem, progress):
        spent = ratio * progress.counts.gradients / point  # of all starts, and of the steps of a line search
        if spent > budget:
            break
        # Scored as the others are; the scoring itself is not charged, for the search has that value already.
        cost.append(spent)
        best.append(min(best[-1], *map(of, progress.good)))
    return Trace("gradient", np.array(cost), np.array(best))


def _traced(
    name: str, of: Callable[[np.ndarray], float], run: Any, problem: Problem, budget: int, at_start: float
) -> Trace:
    cost, best = [1.0], [at_start]

    def counted(unit: np.ndarray) -> float:
        if len(cost) > budget:
            raise _Enough
        value = of(unit)
        cost.append(cost[-1] + 1.0)
        best.append(min(best[-1], value))
        return value if np.isfinite(value) else 1e12

    with suppress(_Enough):
        run(problem, counted)
    return Trace(name, np.array(cost), np.array(best))


def _evolution(problem: Problem, of: Callable[[np.ndarray], float]) -> None:
    from scipy.optimize import differential_evolution

    n = len(problem.names)
    differential_evolution(
        of, [(0.0, 1.0)] * n, x0=problem.start, rng=problem.study.search.seed, polish=False, maxiter=10_000
    )


def _simplex(problem: Problem, of: Callable[[np.ndarray], float]) -> None:
    from scipy.optimize import minimize

    n = len(problem.names)
    sides = np.where(problem.start[None] > 0.5, -0.15, 0.15) * np.eye(n)
    first = np.concatenate([problem.start[None], problem.start[None] + sides])
    minimize(of, problem.start, method="Nelder-Mead", bounds=[(0.0, 1.0)] * n,
             options={"initial_simplex": first, "maxfev": 10**9, "maxiter": 10**9, "xatol": 1e-6, "fatol": 1e-9})  # fmt: skip


def reached(trace: Trace, target: float) -> float | None:
    """Cost at which a trace reaches the target; None also where there is none, for the gradient found nothing."""
    found = np.flatnonzero((trace.best <= target) & np.isfinite(target))
    return float(trace.cost[found[0]]) if len(found) else None


def table(found: Comparison) -> str:
    """Simulations to the target, what each had in the end, and a sentence where a search found nothing."""
    base = reached(found.traces[0], found.target)
    target = f"target {found.target:.5g}" if np.isfinite(found.target) else "no target"
    lines = [
        f"{found.variables} variables; a value with its gradient costs {found.ratio:.1f} forward runs; {target}",
        f"{'search':<24}{'forward runs':>14}{'times the gradient':>20}{'best at the end':>18}",
    ]
    for trace in found.traces:
        cost, best = reached(trace, found.target), trace.best[-1]
        often = "-" if cost is None or not base else f"{cost / base:.1f}"
        if cost is None and base:
            often = f"> {trace.cost[-1] / base:.1f}"
        shown = "not reached" if cost is None else f"{cost:.0f}"
        last = f"{best:.5g}" if np.isfinite(best) else "none"
        lines.append(f"{trace.name:<24}{shown:>14}{often:>20}{last:>18}")
    return "\n".join([*lines, *_not_found(found)])


def _not_found(found: Comparison) -> list[str]:
    """One sentence where no search found a point, or the gradient none; they all begin at one start."""
    gradient = found.traces[0]
    least, start = min(t.best[-1] for t in found.traces), gradient.best[0]
    if not np.isfinite(least):
        return ["no search found a point at which the run holds"]
    if not np.isfinite(gradient.best[-1]):
        return ["the gradient found no point at which the run holds: there is no target"]
    if least >= start:
        return ["no search found a point better than the start"]
    if gradient.best[-1] >= start:
        return ["the gradient found no point better than the start, which is the target"]
    return []


FILES = ("comparison.png", "comparison.json")
"""The last comes last into the folder."""


def write_comparison(folder: Path, found: Comparison) -> list[str]:
    """Numbers, null where there is none, and a picture. The numbers first: a picture that fails must not cost them."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = {
        t.name: {"forward_runs": reached(t, found.target), "best": t.best[-1], "falls": _falls(t)} for t in found.traces
    }
    data = {"target": found.target, "gradient_cost": found.ratio, "variables": found.variables, "searches": rows}
    write_whole(folder / "comparison.json", json.dumps(plain(data), indent=2, allow_nan=False) + "\n")
    plot_style.save(folder / "comparison.png", lambda: picture(found))
    return list(FILES)


def _falls(trace: Trace) -> list[list[float]]:
    """[cost, best] at every gain."""
    gains = np.flatnonzero(trace.best < np.append(np.inf, trace.best[:-1]))
    return [[float(trace.cost[k]), float(trace.best[k])] for k in gains]


def picture(found: Comparison) -> "Axes":
    """How far the best punished objective is above the best of all searches, against cost. Where it is that best, a curve
    comes down to the axis."""
    ax = plot_style.axes(None)
    least = min(t.best[-1] for t in found.traces)
    above = [
        np.subtract(t.best, least, out=np.full(len(t.best), np.nan), where=np.isfinite(t.best)) for t in found.traces
    ]
    positive = np.concatenate([gaps[gaps > 0.0] for gaps in above])
    title = None
    if len(positive):
        goal = [found.target - least] if least < found.target < np.inf else []
        bottom = 0.5 * min([*positive, *goal])
        for i, (trace, gaps) in enumerate(zip(found.traces, above, strict=True)):
            ax.step(trace.cost, np.maximum(gaps, bottom), where="post", label=trace.name, **plot_style.line(i))
        for height in goal:
            ax.axhline(height, color=plot_style.STEEL, linewidth=0.8, label=f"target {found.target:.5g}")
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_ylim(bottom=bottom)
        title = f"At the bottom: the best found, {least:.5g}"
    else:  # a logarithm of nothing is no axis
        words = "\n".join(_not_found(found) or ["no search had a value above the best found"])
        ax.text(0.5, 0.5, words, transform=ax.transAxes, ha="center", fontsize=plot_style.TEXT, color=plot_style.STEEL)
    plot_style.label(ax, "Forward runs", "Punished objective above the best found", title)
    plot_style.legend_beside(ax)
    return ax
