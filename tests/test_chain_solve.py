"""The two ways to solve the chain agree with each other and with a dense constrained solve."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffeed
from diffeed.base.factor import SMALL
from diffeed.base.one_kernel import THRESHOLD
from diffeed.bench.jaxprs import operations
from diffeed.chain import dense, elimination
from diffeed.chain import solve as chain_solve
from diffeed.chain.system import BarTerms, Border, Clamped, System
from diffeed.input.parts import FixedRoller, Scene, Sheet, normalise
from diffeed.model.layout import Layout


def random_system(layout: Layout, seed: int, columns: int, clamps: int = 0) -> System:
    """Random positive blocks, joints, border and clamps."""
    rng = np.random.default_rng(seed)
    n = layout.n_bars
    root = rng.normal(size=(n, 3, 3))
    block = root @ np.swapaxes(root, 1, 2) + np.diag([1.0, 1.0, 0.3])
    entries = [block[:, 0, 0], block[:, 0, 1], block[:, 1, 1], block[:, 0, 2], block[:, 1, 2], block[:, 2, 2]]
    angle = rng.uniform(0, 2 * np.pi, n)
    half = rng.uniform(0.5, 2.0, n)
    coupling = np.where(layout.last, 0.0, 10.0 ** rng.uniform(-3, 3, n))
    border = None
    if columns:
        square = rng.normal(size=(columns, columns))
        matrix = square @ square.T + 50.0 * n * np.eye(columns)  # heavy enough for the whole to be positive
        filled, none = jnp.asarray(matrix), jnp.zeros(columns)
        given = map(jnp.asarray, (rng.normal(size=(columns, 3, n)), rng.normal(size=columns)))
        border = Border(*given, none, none, np.arange(columns), lambda: filled, None)
    held = Clamped(*map(jnp.asarray, (rng.normal(size=(clamps, 3, n)), rng.normal(size=clamps)))) if clamps else None
    return System(
        bars=BarTerms(*map(jnp.asarray, (*entries, *rng.normal(size=(3, n))))),
        coupling=jnp.asarray(coupling),
        lever_x=jnp.asarray(half * np.sin(angle)),
        lever_y=jnp.asarray(-half * np.cos(angle)),
        bias_x=jnp.asarray(rng.normal(size=n)),
        bias_y=jnp.asarray(rng.normal(size=n)),
        border=border,
        clamps=held,
    )


def constrained_solve(system: System, layout: Layout) -> np.ndarray:
    """All accelerations by one saddle-point system, written down row by row: (3 bars + border,)."""
    n, b = layout.n_bars, system.bars
    size = 3 * n
    matrix, rhs = np.zeros((size, size)), np.zeros(size)
    for i in range(n):
        k = 3 * i
        matrix[k : k + 3, k : k + 3] = np.array(
            [[b.xx[i], b.xy[i], b.xw[i]], [b.xy[i], b.yy[i], b.yw[i]], [b.xw[i], b.yw[i], b.ww[i]]]
        )
        rhs[k : k + 3] = [b.fx[i], b.fy[i], b.fw[i]]
    rows, closing = [], []
    for i in range(n - 1):
        if layout.last[i]:
            continue
        e, k, j = float(system.coupling[i]), 3 * i, 3 * (i + 1)
        matrix[k + 2, k + 2] += e
        matrix[j + 2, j + 2] += e
        matrix[k + 2, j + 2] -= e
        matrix[j + 2, k + 2] -= e
        for axis, (lever, bias) in enumerate(((system.lever_x, system.bias_x), (system.lever_y, system.bias_y))):
            # The rear node of bar i, seen from its centre, is the front node of bar i + 1.
            row = np.zeros(size)
            row[k + axis], row[k + 2], row[j + axis], row[j + 2] = 1.0, lever[i], -1.0, lever[i + 1]
            rows.append(row)
            closing.append(-bias[i] - bias[i + 1])
    joints = np.array(rows).reshape(-1, size)
    columns, own, more = np.zeros((0, size)), np.zeros((0, 0)), np.zeros(0)
    if system.border is not None:
        columns = np.asarray(system.border.columns).transpose(0, 2, 1).reshape(-1, size)
        own, more = np.asarray(system.border.matrix()), np.asarray(system.border.rhs)
    if system.clamps is not None:
        held = np.asarray(system.clamps.columns).transpose(0, 2, 1).reshape(-1, size)
        columns, more = np.concatenate([columns, held]), np.concatenate([more, np.asarray(system.clamps.rhs)])
        own = np.pad(own, (0, len(held)))
    m, c = len(joints), len(columns)
    full = np.block(
        [
            [matrix, columns.T, joints.T],
            [columns, own, np.zeros((c, m))],
            [joints, np.zeros((m, c)), np.zeros((m, m))],
        ]
    )
    return np.linalg.solve(full, np.concatenate([rhs, more, closing]))[: size + c]


@pytest.mark.parametrize("bars", [(1,), (2,), (7,), (3, 1, 4)])
@pytest.mark.parametrize("columns", [0, pytest.param(1, marks=pytest.mark.long), 3])
@pytest.mark.parametrize("clamps", [0, pytest.param(1, marks=pytest.mark.long), 3])
@pytest.mark.parametrize(("way", "loops"), [(dense, "dear"), (elimination, "dear"), (elimination, "cheap")])
def test_solution_is_that_of_the_constrained_system(monkeypatch, bars, columns, clamps, way, loops):
    layout = Layout(tuple(f"s{k}" for k in range(len(bars))), bars)
    system = random_system(layout, 7 * sum(bars) + columns, columns, clamps)
    monkeypatch.setattr(chain_solve, "DENSE_UP_TO", 10_000 if way is dense else 0)
    monkeypatch.setenv("XLA_FLAGS", THRESHOLD if loops == "cheap" else "")  # read while tracing only
    found = jax.jit(lambda: chain_solve.solve(system, layout))()
    flat = np.concatenate([np.stack([found.x, found.y, found.w], axis=1).ravel(), found.border, found.reaction])
    np.testing.assert_allclose(flat, constrained_solve(system, layout), rtol=1e-9, atol=1e-9)


@pytest.mark.long
@pytest.mark.usefixtures("loops_are_dear")
@pytest.mark.parametrize("clamps", [0, 2])
def test_rollers_apart_are_eliminated_one_by_one(monkeypatch, clamps):
    """Three with one unknown, two with two: as the whole matrix has it."""
    layout = Layout(("a", "b"), (4, 3))
    system = random_system(layout, 5, 7, clamps)
    twin = np.array([0, 4, 5, 3, 1, 2, 6])
    matrix = system.border.matrix()
    own, mixed = jnp.diagonal(matrix), jnp.where(twin == np.arange(7), 0.0, matrix[np.arange(7), twin])
    border = system.border._replace(own=own, mixed=mixed, twin=twin, rest=lambda: jnp.zeros((7, 7)))
    solve = jax.jit(lambda apart: chain_solve.solve(system._replace(border=border._replace(apart=apart)), layout))
    monkeypatch.setattr(dense, "APART_FROM", 7)
    whole, apart = solve(False), solve(True)
    for a, b in zip(whole, apart, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)
    assert any((np.asarray(a) != np.asarray(b)).any() for a, b in zip(whole, apart, strict=True)), "two ways"
    known = chain_solve.solve(system._replace(border=border._replace(apart=True)), layout)
    for a, b in zip(known, apart, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-14)


@pytest.mark.usefixtures("loops_are_cheap")
@pytest.mark.parametrize("many", [True, False])
def test_rollers_too_many_for_loops_are_eliminated_before_the_bars(monkeypatch, many):
    layout = Layout(("a", "b"), (4, 3))
    count = SMALL + 1 if many else SMALL
    system = random_system(layout, 5, count, 0)
    own, none = jnp.diagonal(system.border.matrix()), jnp.zeros((count, count))
    border = system.border._replace(own=own, mixed=0.0 * own, rest=lambda: none, apart=True)
    system, asked = system._replace(border=border), []
    monkeypatch.setattr(dense, "respond", lambda *given, way=dense.respond: asked.append("matrix") or way(*given))
    found = chain_solve.solve(system, layout)
    assert asked == ["matrix"] * many
    other = elimination.respond(system, layout, jnp.stack(system.bars[6:9])[None], border.rhs[None])
    for one, two in zip(found[:4], other, strict=True):
        np.testing.assert_allclose(one, two[0], rtol=1e-9, atol=1e-12)


def test_rollers_that_never_meet_cost_no_choice():
    """Idle rollers on fixed shafts: no pair of them, so that one way is compiled."""

    def choices(rollers: dict) -> int:
        strip = Sheet(length=50.0, thickness=0.1, width=50.0, density=8e-7, youngs_modulus=3e3, bars=4)
        scene = Scene(sheets={"strip": strip}, rollers=rollers, initial="given")
        return list(operations(lambda s: diffeed.simulate(s, 2e-4, 1e-4, 2), normalise(scene))).count("cond")

    idle = {f"idle_{k}": FixedRoller(center=(30.0 * k, -10.0), radius=5.0) for k in range(16)}
    few = {name: idle[name] for name in sorted(idle)[:15]}
    assert choices(idle) == choices(few)


@pytest.mark.long
def test_long_chain_keeps_its_digits():
    layout = Layout(("s",), (300,))
    system = random_system(layout, 1, 2)
    sides = jnp.stack([system.bars.fx, system.bars.fy, system.bars.fw])[None]
    border = system.border.rhs[None]
    slow = dense.respond(system, layout, sides, border)
    fast = jax.jit(lambda *given: elimination.respond(system, layout, *given))(sides, border)
    for a, b in zip(slow, fast, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-10 * float(jnp.max(jnp.abs(a))))
