"""Guides that go on in each other must bear on the same side: else a sheet on one comes out behind the other."""

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np

from diffeed.input.check_values import show
from diffeed.input.parts import ArcGuide, CircleGuide, LineGuide, Scene
from diffeed.model.guides import JOIN_TOLERANCE

MOST = 200
"""Guides up to which every two are looked at."""
IN_FRONT = "a line guide bears on the left of start to end, an arc on its `side`"


class _End(NamedTuple):
    part: str
    at: np.ndarray
    inwards: np.ndarray  # from the end into the guide
    normal: np.ndarray  # to where the sheet runs


def opposed(scene: Scene) -> Iterator[str]:
    """Of a normalised scene: still guides of which one goes on where the other ends, with faces that look away from each other.
    The two faces of a wedge, which go the same way from its tip, may."""
    still = {name: g for name, g in scene.guides.items() if not isinstance(g, CircleGuide) and g.motion is None}
    if len(still) > MOST:
        return
    ends = [end for name, guide in still.items() for end in _ends(f"guides.{name}", guide)]
    for a, b in combinations(ends, 2):
        meet = a.part != b.part and np.hypot(*(a.at - b.at)) < JOIN_TOLERANCE
        if meet and a.inwards @ b.inwards < -0.5 and a.normal @ b.normal < -0.5:
            yield (
                f"{a.part} and {b.part} go on in each other at {show([round(float(v), 3) for v in a.at])} but bear on opposite"
                f" sides: turn one about ({IN_FRONT})"
            )


def _ends(part: str, guide: LineGuide | ArcGuide) -> list[_End]:
    if isinstance(guide, LineGuide):
        start, end = np.asarray(guide.start), np.asarray(guide.end)
        way = (end - start) / np.hypot(*(end - start))
        normal = np.array([-way[1], way[0]])
        return [_End(part, start, way, normal), _End(part, end, -way, normal)]
    begin, sweep = (float(np.deg2rad(v)) for v in (guide.start_angle, guide.sweep))
    if abs(sweep) >= 2.0 * np.pi:
        return []
    found = []
    for angle, turn in ((begin, sweep), (begin + sweep, -sweep)):
        out = np.array([np.cos(angle), np.sin(angle)])
        along = np.sign(turn) * np.array([-out[1], out[0]])
        at = np.asarray(guide.center) + float(guide.radius) * out
        found.append(_End(part, at, along, -out if guide.side == "inside" else out))
    return found
