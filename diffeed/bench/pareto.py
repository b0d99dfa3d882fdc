"""Which settings are worth having: those that no other beats in cost and error at once."""

import math
from collections.abc import Sequence


def pareto(costs: Sequence[float | None], errors: Sequence[float | None]) -> list[int]:
    """Indices of the points that no other point beats (at most as dear and as wrong, and better in one), cheapest first.

    Points with a value that is missing or not finite are never among them; of equal points the first is.
    """
    known = [
        (c, e, k)
        for k, (c, e) in enumerate(zip(costs, errors, strict=True))
        if c is not None and e is not None and math.isfinite(c) and math.isfinite(e)
    ]
    kept, least = [], math.inf
    for _, error, k in sorted(known):
        if error < least:
            kept.append(k)
            least = error
    return kept
