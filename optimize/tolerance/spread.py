"""One compiled program for a chunk of rows, spread over all local devices."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from diffeed import tuning
from diffeed.abreast import for_many
from diffeed.base.batching import for_each

TOGETHER = 8
"""Samples that a processor core is given at once: a group abreast (`diffeed.abreast`)."""
SHARE = 0.25
"""Share of an accelerator's memory that a chunk may take."""
FEWEST, BUSY = 16, 16384
"""Samples that an accelerator computes at once: fewer take it as long, more keep it no busier (`diffeed bench batch`)."""


def chunk_size(each: Callable[[], int], rows: int) -> int:
    """How many of `rows` are computed at once: for each core what fits its cache, for an accelerator a power of two that fits
    its memory, at `each()` bytes, and is not half empty."""
    devices = tuning.safe_devices(jax.local_devices())
    if devices[0].platform == "cpu":
        return TOGETHER * len(devices)
    room = SHARE * (devices[0].memory_stats() or {}).get("bytes_limit", 8e9) / each()
    most = np.clip(np.floor(np.log2(room)), np.log2(FEWEST), np.log2(BUSY))
    wanted = np.ceil(np.log2(max(FEWEST, rows / len(devices))))
    return len(devices) * int(2 ** min(most, wanted))


class Spread:
    """`function` of one row (n,) and of what all rows are given, mapped over at most `chunk` rows at a time: every call has
    the same shape, what is missing is filled up with the first row.

    With `abreast` several rows are computed at once, which is faster, and has no derivatives inside it. Then the function
    gives, beside what it finds, whether the row must be run again by itself, since what it shared did not suffice."""

    def __init__(self, function: Callable[[Array, Any], Any], chunk: int, abreast: bool = False) -> None:
        devices = np.array(tuning.safe_devices(jax.local_devices()))
        # A chunk is spread evenly; one that is too small for all devices takes fewer.
        devices = devices[: max(n for n in range(1, len(devices) + 1) if chunk % n == 0)]
        self.chunk = chunk
        self._place = NamedSharding(Mesh(devices, ("samples",)), PartitionSpec("samples"))

        def many(rows: Array, given: Any) -> Any:
            return (for_many if abreast else for_each)(lambda row: function(row, given))(rows)

        if len(devices) > 1:
            spec, to_all = PartitionSpec("samples"), PartitionSpec()
            many = jax.shard_map(many, mesh=self._place.mesh, in_specs=(spec, to_all), out_specs=spec, check_vma=False)
        self._run = jax.jit(many)
        self._alone = Spread(lambda row, given: function(row, given)[0], chunk) if abreast else None

    def chunk_of(self, rows: np.ndarray, given: Any = None) -> Any:
        """Results of at most `chunk` rows (m, n), each (m, ...)."""
        count = len(rows)
        filled = np.concatenate([rows, np.repeat(rows[:1], self.chunk - count, axis=0)])
        found = jax.device_get(self._run(jax.device_put(jnp.asarray(filled), self._place), given))
        found = jax.tree.map(lambda v: v[:count], found)
        if self._alone is None:
            return found
        found, again = found
        if not again.any():  # else a second program is compiled
            return found
        alone = self._alone.chunk_of(rows[again], given)
        return jax.tree.map(lambda v, new: _with(v, again, new), found, alone)

    def all_of(self, rows: np.ndarray, given: Any = None) -> Any:
        """Results of any number of rows (m, n), m > 0."""
        parts = [self.chunk_of(rows[k : k + self.chunk], given) for k in range(0, len(rows), self.chunk)]
        return jax.tree.map(lambda *v: np.concatenate(v), *parts)


def _with(values: np.ndarray, which: np.ndarray, new: np.ndarray) -> np.ndarray:
    values = np.array(values)
    values[which] = new
    return values
