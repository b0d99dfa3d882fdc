"""Every test runs in float64, without silent rank or dtype promotion; a test that needs float32 says so itself."""

import jax
import matplotlib
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")
matplotlib.use("Agg")


@pytest.fixture(autouse=True, scope="module")
def _forget_compiled_programs():
    """A process can map only so many compiled programs; those of one module are of no use to the next."""
    yield
    jax.clear_caches()
