"""Optimisers of optax by name, with schedule and clipping. The search adds nothing of its own to their steps."""

import inspect

import optax

from optimize.study import Search

_LEFT_OUT = (
    "lbfgs", "sophia", "multi_transform", "masked", "polyak_sgd", "optimistic_gradient_descent", "noisy_sgd",
    "optimistic_adam",  # deprecated
)  # fmt: skip
UNSCHEDULED = ("rprop", "sm3")
"""Their learning rate must be a number."""


def _is_optimiser(name: str) -> bool:
    made = getattr(optax, name, None)
    if not callable(made) or name.startswith(("_", "scale_")) or name in _LEFT_OUT:
        return False
    try:
        wanted = inspect.signature(made).parameters
    except (TypeError, ValueError):
        return False
    needed = [p for p in wanted.values() if p.default is p.empty and p.kind is not p.VAR_KEYWORD]
    return "learning_rate" in wanted and [p.name for p in needed] in ([], ["learning_rate"])


OPTIMISERS = ("lbfgs", *sorted(n for n in dir(optax) if _is_optimiser(n)))
"""Names that a study may use."""


def make_optimiser(search: Search, iterations: int) -> optax.GradientTransformation:
    """The chain: clip the gradient's norm, then the optimiser with its schedule."""
    rate = {
        "constant": lambda: search.learning_rate,
        "cosine": lambda: optax.cosine_decay_schedule(search.learning_rate, iterations, alpha=0.05),
        "exponential": lambda: optax.exponential_decay(search.learning_rate, iterations, 0.05),
    }[search.schedule]()
    steps = [] if search.clip is None else [optax.clip_by_global_norm(search.clip)]
    return optax.chain(*steps, getattr(optax, search.name)(learning_rate=rate))
