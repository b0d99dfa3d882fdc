"""Guides that go on in each other must bear on the same side: else a sheet on one comes out behind the other."""

from collections.abc import Iterator
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from diffeed.input.check_values import show, sound
from diffeed.input.parts import ArcGuide, LineGuide, Scene

JOIN_TOLERANCE = 1e-3
"""mm: guide ends closer than this are one end."""
MOST = 200
"""Guides up to which every two are looked at."""


class _End(NamedTuple):
    part: str
    at: np.ndarray
    inwards: np.ndarray  # from the end into the guide
    normal: np.ndarray  # to where the sheet runs


def opposed_joints(_: str, scene: Scene, __: Scene) -> Iterator[str]:
    """Two still guides that meet end to end, one going on where the other ends, with faces that look away from each other. The
    two faces of a wedge, which go the same way from its tip, may."""
    guides = scene.guides if isinstance(scene.guides, dict) else {}
    if len(guides) > MOST:
        return
    ends = [e for name, g in guides.items() for e in _ends(f"guides.{name}", g) if getattr(g, "motion", None) is None]
    for a, b in combinations(ends, 2):
        if a.part == b.part or np.hypot(*(a.at - b.at)) > JOIN_TOLERANCE:
            continue
        if a.inwards @ b.inwards < -0.5 and a.normal @ b.normal < -0.5:
            yield (
                f"{a.part} and {b.part} go on in each other at {show([round(float(v), 3) for v in a.at])} but bear on opposite"
                " sides: turn one about (a line guide bears on the left of start to end, an arc on its `side`)"
            )


def _ends(part: str, guide: Any) -> list[_End]:
    if isinstance(guide, LineGuide):
        start, end = sound(guide, "start"), sound(guide, "end")
        if start is None or end is None or np.array_equal(start, end):
            return []
        way = (end - start) / np.hypot(*(end - start))
        normal = np.array([-way[1], way[0]])
        return [_End(part, start, way, normal), _End(part, end, -way, normal)]
    if not isinstance(guide, ArcGuide) or not isinstance(guide.side, str):
        return []
    center, radius, begin, sweep = (sound(guide, f) for f in ("center", "radius", "start_angle", "sweep"))
    if center is None or radius is None or begin is None or sweep is None or abs(float(sweep)) >= 360.0:
        return []
    found = []
    for angle, way in ((float(begin), 1.0), (float(begin + sweep), -1.0)):
        out = np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))])
        along = way * float(np.sign(sweep)) * np.array([-out[1], out[0]])
        found.append(_End(part, center + radius * out, along, -out if guide.side == "inside" else out))
    return found
