"""Where loops over short arrays are cheap, and what a step is made of there: sums and loops, no calls of a library.

A step is some hundred operations on arrays of some twenty numbers, and on the processor calling a compiled kernel takes as long
as all that most of them do. XLA makes one kernel of a whole loop, of the steps of a run with their searches too, if a flag allows
it to be so large (`diffeed.tuning` sets it) and if nothing in it scatters, multiplies matrices, sorts or calls a library. Then
running sums beat products with constant matrices, and elimination bar by bar a library's factorisation; and a batch is best
computed one sample after the other (`diffeed.base.batching`).
"""

import os

THRESHOLD = "xla_cpu_small_while_loop_byte_threshold"
"""The flag, with a number of bytes: what loops that become one kernel may read."""


def loops_are_cheap() -> bool:
    """Whether one kernel is made of a loop of steps: on the processor, where the flag is set."""
    import jax  # slow to import, and whoever only sets flags needs none of it

    return THRESHOLD in os.environ.get("XLA_FLAGS", "") and jax.default_backend() == "cpu"
