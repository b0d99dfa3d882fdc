"""May a gradient be believed? Both modes, central differences, and the trend over the step that a designer would make.

A derivative can be exact and useless: through an unresolved impact the lead edge jitters by micrometres when a radius
moves by nanometres, and the derivative follows the jitter. So the exact derivative is held against the slope of a fit
through runs spread over a designer's step: where the two part, the gradient does not predict that step.
"""

import functools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.base.names import hint
from diffeed.input.check_records import checked
from diffeed.input.parts import Scene
from diffeed.input.paths import PathError, listed_paths, numbers_at, put, unit
from diffeed.readings.trajectory import Trajectory
from diffeed.run.rollout import MOST_STEPS, simulate
from diffeed.steppers import DEFAULT

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STEPS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
"""Sizes of central differences, as shares of the span."""
TOGETHER = 16
"""Runs that are computed at once."""
TREND = 0.25
"""Share of the trend by which the exact derivative may miss it and still predict the step."""

History = Callable[[Scene, Trajectory], Array]


class Row(NamedTuple):
    """One number at one time. Derivatives in units of the measure per unit of the number."""

    name: str
    unit: str
    time: float
    forward: float
    reverse: float
    difference: float  # the central difference that agrees best
    step: float  # and its size, in units of the number
    trend: float  # slope of a parabola through runs over +-span
    error: float  # standard error of that slope
    scatter: float  # rms of the runs about the parabola, units of the measure
    span: float
    signal: float  # |trend| span / scatter
    verdict: str  # useful, useless, or flat (no effect that stands out from the scatter)


class GradientCheck(NamedTuple):
    """What `gradient_check` found. `horizon`: time (s) from which a gradient no longer predicts the step, by name."""

    rows: list[Row]
    horizon: dict[str, float]
    times: np.ndarray  # (frames,)
    exact: dict[str, np.ndarray]  # (frames,) derivative over time
    trend: dict[str, np.ndarray]
    error: dict[str, np.ndarray]

    def __str__(self) -> str:
        return table(self)

    def plot(self, name: str | None = None, ax: "Axes | None" = None) -> "Axes":
        return plot(self, name, ax)


def gradient_check(
    scene: Scene,
    paths: Sequence[str],
    history: History | None = None,
    spans: dict[str, float] | None = None,
    times: Sequence[float] | None = None,
    duration: float | None = None,
    dt: float | None = None,
    frames: int = 41,
    samples: int = 64,
    method: str = DEFAULT,
    observe: tuple[str, ...] = (),
    tolerance: float | None = None,
    most_steps: int = MOST_STEPS,
) -> GradientCheck:
    """Check the derivatives of a history of a run with respect to numbers of a scene.

    `history(scene, trajectory)` gives (frames,) values; None: the place of the lead edge, mm. `spans`: half the step that
    a designer would make, by path; 0.2 % of the value otherwise (0.02 mm for a roller of 10 mm). `times`: where to report
    (the nearest frames); None: the end. `samples` runs are spread over each span.
    """
    scene, paths = checked(scene), listed_paths(paths)
    for path in paths:
        if np.ndim(numbers_at(scene, path)):
            raise PathError(f'"{path}" is a vector: name its entries, "{path}[0]" and so on')
    start = np.array([float(numbers_at(scene, p)) for p in paths])
    spans = spans or {}
    if strange := [name for name in spans if name not in paths]:
        raise ValueError(f'spans names "{strange[0]}", which is none of the paths{hint(strange[0], paths)}')
    widths = np.array([spans.get(p, 2e-3 * abs(v) or 1e-3) for p, v in zip(paths, start, strict=True)])
    run_of = functools.partial(
        simulate, duration=duration, dt=dt, frames=frames, method=method, observe=observe,
        tolerance=tolerance, most_steps=most_steps,
    )  # fmt: skip
    nominal = run_of(scene)

    def of(values: Array) -> Array:
        changed = scene
        for path, value in zip(paths, values, strict=True):
            changed = put(changed, path, value)
        run = run_of(changed)
        return lead_edge_from(nominal, run) if history is None else history(changed, run)

    return check_function(of, start, tuple(paths), tuple(unit(scene, p) for p in paths), widths,
                          np.asarray(nominal.time), times, samples)  # fmt: skip


def lead_edge_from(nominal: Trajectory, run: Trajectory) -> Array:
    """(frames,) mm: how far the lead edge is ahead of the nominal run's, along the nominal way."""
    name = min(run.sheets)
    velocity = nominal.sheets[name].velocities[:, 0]
    speed = jnp.sqrt(jnp.sum(velocity**2, axis=1, keepdims=True))
    way = jnp.where(speed > 0, velocity / jnp.where(speed > 0, speed, 1.0), jnp.array([1.0, 0.0]))
    return jnp.sum((run.sheets[name].nodes[:, 0] - nominal.sheets[name].nodes[:, 0]) * way, axis=1)


def check_function(
    of: Callable[[Array], Array],
    start: np.ndarray,
    names: tuple[str, ...],
    units: tuple[str, ...],
    spans: np.ndarray,
    clock: np.ndarray,
    times: Sequence[float] | None = None,
    samples: int = 64,
) -> GradientCheck:
    """The same for any function of a vector (n,) that gives a history (frames,)."""
    x = jnp.asarray(start)
    frames = [int(np.argmin(np.abs(clock - t))) for t in (times if times is not None else clock[-1:])]
    forward = np.asarray(jax.jit(jax.jacfwd(of))(x))  # (frames, n)
    reverse = _reverse(of, x, frames)
    offsets = np.concatenate([np.array(STEPS), -np.array(STEPS), np.linspace(-1.0, 1.0, samples)])
    moves = offsets[:, None, None] * np.diag(spans)[None]  # (offsets, n, n)
    batch = jnp.asarray(start[None] + moves.reshape(-1, len(start)))
    values = np.asarray(jax.jit(lambda xs: jax.lax.map(of, xs, batch_size=TOGETHER))(batch))
    values = values.reshape(len(offsets), len(start), -1)  # (offsets, n, frames)
    k = len(STEPS)
    differences = (values[:k] - values[k : 2 * k]) / (2.0 * np.array(STEPS)[:, None, None] * spans[None, :, None])
    slope, error, scatter = fit(offsets[2 * k :], values[2 * k :])
    trend, error = slope / spans[:, None], error / spans[:, None]
    rows = []
    for f in frames:
        for i, name in enumerate(names):
            exact = forward[f, i]
            best = int(np.nanargmin(np.abs(differences[:, i, f] - exact))) if np.isfinite(exact) else 0
            signal = abs(trend[i, f]) * spans[i] / scatter[i, f] if scatter[i, f] > 0 else np.inf
            rows.append(
                Row(name, units[i], float(clock[f]), float(exact), float(reverse[frames.index(f), i]),
                    float(differences[best, i, f]), STEPS[best] * float(spans[i]), float(trend[i, f]),
                    float(error[i, f]), float(scatter[i, f]), float(spans[i]), float(signal),
                    _judge(exact, trend[i, f], error[i, f]))
            )  # fmt: skip
    exact = {name: forward[:, i] for i, name in enumerate(names)}
    parted = {name: _horizon(clock, forward[:, i], trend[i], error[i]) for i, name in enumerate(names)}
    return GradientCheck(
        rows, parted, clock, exact, dict(zip(names, trend, strict=True)), dict(zip(names, error, strict=True))
    )


def _reverse(of: Callable[[Array], Array], x: Array, frames: list[int]) -> np.ndarray:
    """(reported frames, n) by reverse mode."""
    pull = jax.jit(lambda x, k: jax.grad(lambda y: of(y)[k])(x))
    return np.stack([np.asarray(pull(x, f)) for f in frames])


def fit(u: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parabola through values (samples, n, frames) at u: slope at 0 per unit u, its standard error, rms residual."""
    design = np.stack([np.ones_like(u), u, u * u], axis=1)
    flat = values.reshape(len(u), -1)
    found, *_ = np.linalg.lstsq(design, flat, rcond=None)
    left = flat - design @ found
    scatter = np.sqrt(np.sum(left**2, axis=0) / max(len(u) - 3, 1))
    error = scatter * np.sqrt(np.linalg.inv(design.T @ design)[1, 1])
    shape = values.shape[1:]
    return found[1].reshape(shape), error.reshape(shape), scatter.reshape(shape)


def _judge(exact: float, trend: float, error: float) -> str:
    """`flat`: the trend does not stand out from its error, nor the derivative; `useless`: they contradict each other."""
    if not np.isfinite(exact) or not np.isfinite(trend):
        return "not finite"
    if abs(exact - trend) <= TREND * abs(trend) + 3.0 * error:
        return "useful" if abs(trend) > 3.0 * error else "flat"
    return "useless"


def _horizon(clock: np.ndarray, exact: np.ndarray, trend: np.ndarray, error: np.ndarray) -> float:
    """First time from which the gradient stays useless for three frames; infinity if it never does."""
    bad = np.array([_judge(*v) in ("useless", "not finite") for v in zip(exact, trend, error, strict=True)])
    run = np.convolve(bad, np.ones(3), mode="full")[2:] if len(bad) >= 3 else bad * 3.0
    found = np.flatnonzero(run[: len(bad)] >= min(3, len(bad)))
    return float(clock[found[0]]) if len(found) else float("inf")


def table(check: GradientCheck) -> str:
    """A readable table: one line per number and time."""
    head = ("number", "time s", "forward", "reverse", "difference", "trend", "+-", "signal/noise", "verdict")
    lines = [
        (r.name, f"{r.time:.3g}", *(f"{v:.6g}" for v in (r.forward, r.reverse, r.difference)), f"{r.trend:.4g}",
         f"{r.error:.1g}", f"{r.signal:.3g}", r.verdict)
        for r in check.rows
    ]  # fmt: skip
    widths = [max(len(row[k]) for row in (head, *lines)) for k in range(len(head))]
    text = [
        "  ".join(c.ljust(w) if k == 0 else c.rjust(w) for k, (c, w) in enumerate(zip(row, widths, strict=True)))
        for row in (head, *lines)
    ]
    parted = [f"{n}: does not predict the step from {t:.3g} s on" for n, t in check.horizon.items() if np.isfinite(t)]
    return "\n".join([*text, *parted])


def plot(check: GradientCheck, name: str | None = None, ax: "Axes | None" = None) -> "Axes":
    """Exact derivative and trend (with three standard errors) of one number over time."""
    from diffeed import plot_style

    name = next(iter(check.exact)) if name is None else name
    row = next(r for r in check.rows if r.name == name)
    ax = plot_style.axes(ax)
    trend, error, t = check.trend[name], 3.0 * check.error[name], check.times
    ax.fill_between(t, trend - error, trend + error, color=plot_style.FAINT, label="trend, three standard errors")
    ax.plot(t, trend, label=f"trend over +-{row.span:.3g} {row.unit}", **plot_style.line(0))
    ax.plot(t, check.exact[name], label="exact derivative", **plot_style.line(1))
    plot_style.leave_out_peaks(ax, np.concatenate([trend, check.exact[name]]))
    plot_style.label(ax, "Time (s)", f"Change of the measure per {row.unit}", name)
    plot_style.legend_beside(ax)
    return ax
