"""Samples side by side in one run's kernel: each operation of a run is computed for all of a group at once, on a last axis.

`jax.vmap` puts samples first, and looks up for each its own pairs. On the last axis eight samples are what the processor computes
in one go, and what a group looks at is chosen once for all (`diffeed.base.batching.least_of_group`): a group takes less
than half the time of its samples one after the other (`diffeed bench batch`).

`values` says what a walk hands on, `arrays` and `loops` have a rule for each of JAX's operations, `walk` applies them.
"""

from diffeed.abreast.walk import for_many

__all__ = ["for_many"]
