"""Samples abreast: what `jax.vmap` gives, on the last axis; runs that do not depend on who else is in the group."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from diffeed.abreast import for_many
from diffeed.abreast.walk import GROUP, abreast
from diffeed.base.batching import any_of_batch, least_of_group
from diffeed.base.once import derived_once
from diffeed.base.places import PLACE, add_at, at_places
from diffeed.base.smallest import smallest
from optimize.tolerance.spread import Spread

RANDOM = np.random.default_rng(11)
SAMPLES = 5
ROWS = jnp.asarray(RANDOM.normal(size=(SAMPLES, 6)))
TABLE = jnp.asarray(RANDOM.normal(size=(SAMPLES, 6, 3)))
PLACES = jnp.asarray(RANDOM.integers(0, 6, (SAMPLES, 4)), PLACE)
KNOWN = jnp.asarray([4, 0, 4, 2], PLACE)
SHARED = jnp.asarray(RANDOM.normal(size=6))


def counted(row):
    """A loop that each sample leaves by itself."""
    return lax.while_loop(
        lambda c: (c[0] < 40) & (c[1].sum() < 30.0), lambda c: (c[0] + 1, 1.1 * c[1] + 0.1), (0, jnp.abs(row))
    )


def running(row, table):
    """A scan that comes to differ only by its rows; what it carries beside stays shared."""

    def one(carry, each):
        total, turns = carry
        return (total + each.sum() * SHARED[turns], turns + 1), (total, turns, each[0])

    return lax.scan(one, (0.0, 0), table, reverse=True)


def chosen(row):
    which = (row[0] > 0).astype(int) + (row[1] > 0).astype(int)
    by_each = lax.switch(which, [lambda r: r, lambda r: r**2, lambda r: jnp.cos(r)], row)
    shared = lax.cond(SHARED[0] > 10.0, lambda r: SHARED, lambda r: r, row)
    return by_each, shared, lax.cond(any_of_batch(row[0] > 0.0), lambda r: r + 1.0, lambda r: r, row)


def summed(row, places, table):
    values = [row[:4], table[:4, 1], SHARED[:4]]
    return add_at(6, KNOWN, values), add_at(6, places, values), add_at(6, places, [SHARED[:4]])


def taken(row, places, table):
    """At places of its own and at those of all; rows, columns and slices."""
    mine, start = at_places(row, places), places[0].astype(int)
    whole = at_places(table.T, places.reshape(2, 2)), at_places(SHARED, places), at_places(table.T, KNOWN)
    slices = lax.dynamic_slice(table, (start // 2, 1), (2, 2)), lax.dynamic_slice(table, (KNOWN[3], PLACE(0)), (2, 3))
    put = lax.dynamic_update_slice(table, table[:2, :1], (KNOWN[3], PLACE(1)))
    own = lax.dynamic_update_slice(row, row[:2], (start // 2,))
    return (
        mine,
        whole,
        slices,
        put,
        own,
        table[places],
        table[places, 1],
        table[KNOWN],
        jnp.take_along_axis(table, places[:3][None] % 6, 0),
    )


def scattered(row, places, table):
    own = jnp.zeros(6).at[places].add(row[:4])
    return own, jnp.zeros((6, 3)).at[KNOWN].add(table[:4]), table.at[KNOWN[0]].set(0.0), table.at[1].max(SHARED[:3])


def joined(row, table):
    flags = table > 0.0
    totals = lax.reduce((table, flags), (0.0, False), lambda a, b: (a[0] + b[0], a[1] | b[1]), (0, 1))
    many = jnp.sum(jnp.tile(row, 60))
    of = (
        table.sum(),
        table.sum(1),
        table.max(0),
        table.min(),
        flags.any(),
        flags.all(0),
        table.argmax(0),
        table.prod(1),
        many,
    )
    return of, totals, jnp.cumsum(table, axis=0), jnp.sum(jnp.zeros((0,)) * row[0])


def shaped(row, table):
    padded = jnp.pad(row, (2, 1)), jnp.pad(row, (0, 2), constant_values=row[0]), lax.pad(row, 7.0, ((0, 1, 2),))
    return (
        *padded,
        row[::-1],
        table.T.reshape(9, 2),
        jnp.concatenate([row, SHARED]),
        jnp.stack([row, SHARED], axis=1),
        jnp.split(row, [2, 3]),
        table[1:5:2, ::-1],
        jnp.clip(row, -0.5, row[0] + 1.0),
        row[:, None] * SHARED[None],
        jnp.where(row[0] > 0, table, 1.0),
        jnp.broadcast_to(row[:, None], (6, 4)),
        jnp.expand_dims(row, 0).squeeze(),
        3 * row.astype(jnp.float32),
    )


def derived(row):
    """Through operations that stand for others, and such as have no rule here."""
    matrix = jnp.eye(6) + 0.1 * jnp.outer(row, row)
    slope = jax.grad(lambda r: jnp.sum(derived_once(r) ** 3))(row)
    return (
        slope,
        jnp.linalg.cholesky(matrix),
        matrix @ row,
        jnp.sort(row),
        jax.checkpoint(jnp.sin)(row),
        smallest(row, 2),
    )


FUNCTIONS = {
    f.__name__: (f, given)
    for f, *given in (
        (counted, ROWS), (running, ROWS, TABLE), (chosen, ROWS), (summed, ROWS, PLACES, TABLE), (taken, ROWS, PLACES, TABLE),
        (scattered, ROWS, PLACES, TABLE), (joined, ROWS, TABLE), (shaped, ROWS, TABLE), (derived, ROWS),
    )
}  # fmt: skip


@pytest.mark.parametrize("name", FUNCTIONS)
def test_each_operation_gives_what_vmap_gives(name):
    function, given = FUNCTIONS[name]
    last = [jnp.moveaxis(v, 0, -1) for v in given]
    found, known = jax.jit(abreast(function))(*last), jax.vmap(function)(*given)
    assert jax.tree.structure(found) == jax.tree.structure(known)
    for ours, theirs in zip(jax.tree.leaves(found), jax.tree.leaves(known), strict=True):
        assert ours.dtype == theirs.dtype
        # Sums of up to 360 numbers in another order.
        np.testing.assert_allclose(np.moveaxis(ours, -1, 0), theirs, rtol=360 * np.finfo(float).eps, atol=1e-15)


@pytest.mark.parametrize("count", [1, GROUP - 3, GROUP, 2 * GROUP + 3])
def test_groups_of_any_number(loops_are_cheap, count):
    rows = jnp.asarray(RANDOM.normal(size=(count, 6)))
    found = for_many(lambda row: (row.sum(), {"all": counted(row)}))(rows)
    known = jax.vmap(lambda row: (row.sum(), {"all": counted(row)}))(rows)
    jax.tree.map(lambda ours, theirs: np.testing.assert_allclose(ours, theirs, rtol=1e-14), found, known)


def test_a_derivative_is_refused(loops_are_cheap):
    with pytest.raises(TypeError, match="for_each"):
        jax.grad(lambda rows: for_many(jnp.sum)(rows).sum())(ROWS)


@pytest.mark.parametrize(
    "given", [(jnp.zeros((3, 2)), jnp.zeros((4, 2))), (jnp.zeros((0, 2)),), (jnp.zeros((2, 2)), jnp.zeros(())), ()]
)
def test_stacks_of_unlike_length_are_refused(loops_are_cheap, given):
    with pytest.raises(ValueError, match=r"along its first axis; found (3, 4|0|none)"):
        for_many(lambda *rows: rows)(*given)


def test_a_group_chooses_together(loops_are_cheap):
    """The least of all: not under `vmap`, where each has its own."""
    found = jax.jit(
        abreast(lambda row: (least_of_group(row), least_of_group(SHARED), smallest(least_of_group(row), 2)))
    )(ROWS.T)
    np.testing.assert_array_equal(found[0], np.repeat(ROWS.min(0)[:, None], SAMPLES, axis=1))
    np.testing.assert_array_equal(found[1], np.repeat(SHARED[:, None], SAMPLES, axis=1))
    assert (found[2] == found[2][:, :1]).all()
    np.testing.assert_array_equal(jax.vmap(least_of_group)(ROWS), ROWS)


@pytest.mark.parametrize("cheap", [True, False])
def test_a_row_that_shared_too_much_is_run_again_alone(cheap, request):
    if cheap:
        request.getfixturevalue("loops_are_cheap")
    rows = np.arange(1.0, 12.0)[:, None] * [1.0, 10.0]

    def function(row, given):
        return {"least": least_of_group(row) * given}, row[0] > 9.0

    found = Spread(function, 8, abreast=True).all_of(rows, 2.0)["least"]
    together = np.repeat([rows[0], rows[8]], [8, 3], axis=0) if cheap else rows
    np.testing.assert_array_equal(found, 2.0 * np.where(rows[:, :1] > 9.0, rows, together))


RUNS = """
import sys
from diffeed import tuning
tuning.compile_for_many()
import jax
jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import numpy as np
import diffeed
from diffeed.abreast import for_many
from diffeed.bench.batch import samples
from diffeed.input.parts import normalise
from diffeed.run.examine import prepare

where, dt, steps = sys.argv[1], float(sys.argv[2]), int(sys.argv[3])
scene = normalise(diffeed.load_scene(where))
start, many = prepare(scene).state, samples(scene, 24)

def one(scene):
    run = diffeed.simulate(scene, duration=dt * steps, dt=dt, frames=3, initial=start)
    return run.ok, run.final.state, run

program = jax.jit(for_many(one)).lower(jax.tree.map(lambda v: v[:16], many)).compile()
groups = [[*range(16)], [0] * 8 + [8] * 8, [0, 9, 17, 23, 4, 12, 13, 2, 8, 22, 21, 20, 1, 1, 0, 5]]
found = [program(jax.tree.map(lambda v: v[np.array(group)], many)) for group in groups]
for sample in (0, 8):
    for other in found[1:]:
        for a, b in zip(jax.tree.leaves(found[0]), jax.tree.leaves(other)):
            np.testing.assert_array_equal(a[sample], b[sample], err_msg="who else is in the group")
assert found[0][0].all(), "all hold"
alone = jax.jit(one)(jax.tree.map(lambda v: v[0], many))
apart = max(float(jnp.abs(getattr(found[0][1], n)[0] - getattr(alone[1], n)).max()) for n in ("x", "y", "heading", "travel"))
differ = float(jnp.abs(found[0][1].heading - found[0][1].heading[:1]).max())
print(apart, differ)
"""


@pytest.mark.parametrize(("where", "dt", "steps"), [("film_feeder", 5e-4, 800), ("gap_bridge", 2e-4, 200)])
def test_a_run_does_not_depend_on_the_group(where, dt, steps):
    """Bit by bit; and is that of the sample alone, but for rounding. In a process of its own: it has the flags."""
    environment = {k: v for k, v in os.environ.items() if k != "XLA_FLAGS"}
    told = subprocess.run(
        [sys.executable, "-c", RUNS, where, str(dt), str(steps)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert told.returncode == 0, told.stderr[-2000:]
    apart, differ = map(float, told.stdout.split()[:2])
    assert apart < 1e-12, "mm, rad: rounding (found: 1e-15), a thousand times enlarged by impacts"
    assert differ > 1e-6, "samples differ"
