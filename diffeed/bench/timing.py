"""Compile and run times of a program apart. JAX returns before it is done: every time is taken after waiting."""

import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import jax

MOST, ENOUGH = 25, 1.0
"""Runs at most, and seconds in all after which no more are added to the fewest."""


class Timed(NamedTuple):
    """Times of one program (s) and what it gave."""

    compile: float  # tracing included
    run: float  # median
    repeats: int
    value: Any
    trace: float
    temporary: int | None  # bytes that it works in; None: the device does not tell
    again: Callable[[], float]  # runs it once more, and says how long that took


def timed(function: Callable[..., Any], *arguments: Any, fewest: int = 3) -> Timed:
    """Compile a function for its arguments, then run it until that is `enough`."""
    begun = time.perf_counter()
    lowered = jax.jit(function).lower(*arguments)
    trace_seconds = time.perf_counter() - begun
    compiled = lowered.compile()
    compile_seconds = time.perf_counter() - begun

    def run() -> tuple[Any, float]:
        begun = time.perf_counter()
        value = jax.block_until_ready(compiled(*arguments))
        return value, time.perf_counter() - begun

    value, first = run()
    seconds = [first]
    while not enough(seconds, fewest):
        seconds.append(run()[1])
    temporary = getattr(compiled.memory_analysis(), "temp_size_in_bytes", None)
    median = statistics.median(seconds)
    return Timed(compile_seconds, median, len(seconds), value, trace_seconds, temporary, lambda: run()[1])


def enough(seconds: Sequence[float], fewest: int) -> bool:
    """Whether a program was run often enough: `fewest` times, if more than once then many times if it is short."""
    return len(seconds) >= fewest and (fewest == 1 or len(seconds) >= MOST or sum(seconds) >= ENOUGH)


@contextmanager
def precision(name: str) -> Iterator[None]:
    """Compute in "float64" or "float32" here; the setting of the session comes back afterwards."""
    before = bool(jax.config.values["jax_enable_x64"])
    jax.config.update("jax_enable_x64", name == "float64")
    try:
        yield
    finally:
        jax.config.update("jax_enable_x64", before)
