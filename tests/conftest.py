"""Every test runs in float64, without silent rank or dtype promotion; a test that needs float32 says so itself."""

import gc
import os
from pathlib import Path

import jax
import matplotlib
import pytest
from matplotlib import pyplot

from diffeed import tuning
from diffeed.base.one_kernel import THRESHOLD

# Most tests run a program once. Flags that are given in XLA_FLAGS stay, and commands that are called here add none to these.
tuning.compile_plainly()
# A command called in this process would set it for all processes that are started later.
tuning.use_one_core = lambda: None
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")
matplotlib.use("Agg")


SECOND_ORDER = {"extrapolated_euler", "midpoint"}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Symmetries and transformations hold for every stepper, balances for every seed; of these two steppers they are asked
    among the slow tests: they are made of the step of `linear_euler`, and take twice as long to compile. So is the largest
    structure of the explicit one."""
    for item in items:
        given = item.callspec.params if hasattr(item, "callspec") else {}
        wide = item.path.stem in ("test_properties_symmetry", "test_properties_numerics") and "order" not in item.name
        again = item.path.stem == "test_properties_balance" and "seed" in given
        second = given.get("method") in SECOND_ORDER and (wide or again)
        explicit = given.get("method") == "runge_kutta" and given.get("structure") == "guided" and wide
        if second or explicit:
            item.add_marker(pytest.mark.slow)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """A file's tests go to one process: they share what is compiled."""
    from xdist.scheduler import LoadFileScheduling

    return LoadFileScheduling(config, log)


MOST_MAPS = 30_000
"""Half of what Linux lets one process map; each compiled program takes some."""


@pytest.fixture(autouse=True, scope="module")
def _forget_compiled_programs():
    """A process that has compiled too many programs is ended by the compiler: drop them in time."""
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and len(maps.read_text().splitlines()) > MOST_MAPS:
        jax.clear_caches()
        gc.collect()


@pytest.fixture
def loops_are_dear(monkeypatch):
    """Programs as a library without flags has them, and an accelerator (`diffeed.base.one_kernel`), also where XLA_FLAGS says
    otherwise for all tests; what was traced before is forgotten."""
    monkeypatch.delenv("XLA_FLAGS")
    jax.clear_caches()
    yield
    jax.clear_caches()


@pytest.fixture
def loops_are_cheap(monkeypatch):
    """Programs as benchmarks and studies make them; the compiler itself is not told, for it reads its flags only once."""
    monkeypatch.setenv("XLA_FLAGS", f"{os.environ.get('XLA_FLAGS', '')} {THRESHOLD}")
    jax.clear_caches()
    yield
    jax.clear_caches()


@pytest.fixture(autouse=True)
def _closed_figures():
    """What one test draws is not counted by the next."""
    yield
    pyplot.close("all")


@pytest.fixture
def as_users_have_it():
    """JAX's own settings, for tests of searches: optimisers of optax mix integer counts with floats."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield
