"""What a tolerance study found, in plain numbers: what fails and how often, how measures scatter, what is to blame."""

from typing import Any

import numpy as np

from diffeed import measures
from diffeed.base.files import plain
from optimize.asked import Asked
from optimize.tolerance.confirmation import Confirmation
from optimize.tolerance.contributions import Slopes
from optimize.tolerance.draws import correlation, correlation_of_deviations, epsilons, normals, uniforms
from optimize.tolerance.problem import ToleranceProblem
from optimize.tolerance.run import Rows
from optimize.tolerance.statistics import (
    Indices,
    capability,
    derivative_measure,
    linear_shares,
    normal_slope,
    percentile,
    proportion,
    regression_shares,
    yield_slope,
)

TIGHTER = 0.1
"""Share by which a tolerance is made tighter in the table of what that would bring."""
NORMAL = ("normal", "log_normal")
"""Kinds whose deviates are normal numbers."""
UNKNOWN = (
    "triangular, truncated and measured values, a uniform one of a group, one that is the same draw as another's, and too "
    "few samples"
)
"""What has no estimate of a gain."""
SHOWN = 5
"""Samples named for each way to fail."""


def summarise(
    problem: ToleranceProblem,
    rows: Rows,
    slopes: Slopes | None = None,
    indices: list[Indices] | None = None,
    confirmed: Confirmation | None = None,
) -> dict[str, Any]:
    """Everything, ready for JSON: NaN and infinity become None."""
    linked = correlation_of_deviations(problem.inputs)
    return plain({
        "title": problem.study.title,
        "samples": len(rows.sample),
        "sampling": problem.study.sampling,
        "fails": fails(problem, rows),
        "measures": {a.name: _measure(problem, rows, k, a) for k, a in enumerate(problem.asked)},
        "inputs": {i.name: {"kind": i.of.kind, "sigma": i.sigma, "unit": i.unit} for i in problem.inputs},
        "contributions": {a.name: _blame(problem, rows, k, linked, slopes, indices) for k, a in enumerate(problem.asked)},
        "tighten": tighten(problem, rows),
        "confirmed": None if confirmed is None else confirmed.as_numbers(),
    })  # fmt: skip


def fails(problem: ToleranceProblem, rows: Rows) -> dict[str, Any]:
    """Each way to fail with its exact interval and the first samples that did; "in all" counts a sample once."""
    ran = rows.status != measures.STATUSES.index("failed")
    ways = {"in all": ~rows.passed}
    for name in ("jammed", "late", "failed"):
        hit = rows.status == measures.STATUSES.index(name)
        if name != "late" or problem.scene.goal:
            ways[{"failed": "simulation failed"}.get(name, name)] = hit
    for k, asked in enumerate(problem.limits):
        ways[f"{asked.name} {limit_words(asked)}"] = rows.broken[:, k] & ran
    found = {}
    for name, hit in ways.items():
        share = proportion(int(hit.sum()), len(hit))
        found[name] = {"count": int(hit.sum()), **share._asdict(), "samples": rows.sample[hit][:SHOWN].tolist()}
    return found


def limit_words(asked: Asked) -> str:
    """Where a measure breaks its limit."""
    spec, words = asked.spec, []
    if spec.at_least is not None:
        words.append(f"below {spec.at_least:g}")
    if spec.at_most is not None:
        words.append(f"above {spec.at_most:g}")
    return " or ".join(words)


def limits_of(asked: Asked) -> tuple[float | None, float | None]:
    """Lower and upper limit of a measure, None where there is none."""
    return getattr(asked.spec, "at_least", None), getattr(asked.spec, "at_most", None)


def _measure(problem: ToleranceProblem, rows: Rows, k: int, asked: Asked) -> dict[str, Any]:
    values = rows.values[:, k]
    values = values[~np.isnan(values)]
    if not len(values):
        return {"unit": asked.term.unit, "runs": 0}
    extremes = {"lowest sample": int(rows.sample[np.nanargmin(rows.values[:, k])])}
    extremes["highest sample"] = int(rows.sample[np.nanargmax(rows.values[:, k])])
    finite = values[np.isfinite(values)]
    found = {
        "unit": asked.term.unit,
        "runs": len(values),
        "never": int(len(values) - len(finite)),
        "mean": float(np.mean(finite)) if len(finite) else None,
        "std": float(np.std(finite, ddof=1)) if len(finite) > 1 else None,
        "percentiles": {f"{100 * p:g}": percentile(values, p)._asdict() for p in (0.01, 0.5, 0.99)},
    }
    low, high = limits_of(asked)
    return found | extremes | (capability(values, low, high)._asdict() if low is not None or high is not None else {})


def _blame(
    problem: ToleranceProblem,
    rows: Rows,
    k: int,
    linked: np.ndarray,
    slopes: Slopes | None,
    indices: list[Indices] | None,
) -> dict[str, Any]:
    """Shares of the variance of a measure, (inputs,) each, and how much of it a straight line explains."""
    fine = np.isfinite(rows.values[:, k])
    straight = regression_shares(rows.deviation[fine], rows.values[fine, k], linked)
    sigma = np.array([i.sigma for i in problem.inputs])
    found: dict[str, Any] = {
        "std": float(np.std(rows.values[fine, k], ddof=1)) if fine.sum() > 1 else None,
        "regression": straight.shares,
        "explained": straight.explained,
    }
    if slopes is not None:
        first = linear_shares(slopes.nominal[k], sigma, linked)
        found |= {"first order": first.shares, "first order std": float(np.sqrt(first.variance))}
        found |= {"derivative based": derivative_measure(slopes.samples[:, k], sigma).shares}
        found |= {"gradients": int(np.isfinite(slopes.samples[:, k]).all(axis=1).sum())}
    if indices is not None:
        found |= {f"sobol {name}": value for name, value in indices[k]._asdict().items()}
    return found


def tighten(problem: ToleranceProblem, rows: Rows) -> dict[str, Any]:
    """What making each tolerance 10 % tighter brings: more samples that pass (a share), its standard error, and the gain for
    the cost. A tolerance of several parts is tightened for all of them. NaN where there is no estimate, see `UNKNOWN`."""
    u = uniforms(problem.inputs, problem.study.sampling, problem.study.samples, problem.study.seed)[rows.sample]
    eps = epsilons(problem.inputs, u)
    # A normal input is scored with all that it is drawn with, of whatever kind; what is neither leaves its score alone.
    scored = [k for k, i in enumerate(problem.inputs) if i.of.kind in NORMAL or i.of.group]
    z, linked = normals(problem.inputs, u)[:, scored], correlation(problem.inputs)[np.ix_(scored, scored)]
    found: dict[str, Any] = {}
    for name, of in problem.study.tolerances.items():
        mine = [k for k, i in enumerate(problem.inputs) if i.of is of]
        if of.kind in NORMAL:
            each = [normal_slope(rows.passed, z, linked, [scored.index(k) for k in mine])]
        else:  # in a group such a number is drawn with others: there is no estimate
            each = [yield_slope(rows.passed, eps[:, k], "data" if of.group else of.kind, 1.0) for k in mine]
        gain = -TIGHTER * float(np.sum([s.value for s in each]))
        error = TIGHTER * float(np.linalg.norm([s.error for s in each]))
        found[name] = {"gain": gain, "error": error}
        if of.cost is not None:
            found[name] |= {"cost": of.cost, "gain per cost": gain / of.cost}
    return found
