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


def once(function: Callable[..., Any], *arguments: Any) -> Timed:
    """Compile a function for its arguments, and run it."""
    begun = time.perf_counter()
    lowered = jax.jit(function).lower(*arguments)
    trace_seconds = time.perf_counter() - begun
    compiled = lowered.compile()
    compile_seconds = time.perf_counter() - begun
    digits = "float64" if jax.config.values["jax_enable_x64"] else "float32"

    def run() -> tuple[Any, float]:
        with precision(digits):
            begun = time.perf_counter()
            value = jax.block_until_ready(compiled(*arguments))
            return value, time.perf_counter() - begun

    value, first = run()
    temporary = getattr(compiled.memory_analysis(), "temp_size_in_bytes", None)
    return Timed(compile_seconds, first, 1, value, trace_seconds, temporary, lambda: run()[1])


def in_turns(made: Sequence[Timed], fewest: int = 3) -> list[Timed]:
    """Programs that ran once, run `fewest` times or more: many times if they are short. All in turns, so that what else the
    computer does falls on all alike."""
    seconds = [[m.run] for m in made]
    while waiting := [k for k, s in enumerate(seconds) if not _enough(s, fewest)]:
        for k in waiting:
            seconds[k].append(made[k].again())
    return [m._replace(run=statistics.median(s), repeats=len(s)) for m, s in zip(made, seconds, strict=True)]


def timed(function: Callable[..., Any], *arguments: Any, fewest: int = 3) -> Timed:
    """One program alone."""
    return in_turns([once(function, *arguments)], fewest)[0]


def _enough(seconds: Sequence[float], fewest: int) -> bool:
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
