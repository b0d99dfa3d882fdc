"""How large a scene and a run may be: what asks for more is refused with a sentence, before it fills the memory.

The limits are far above what a machine needs. They hold for anything that reads a file or starts a run.
"""

from typing import Any

MAX_BARS = 10_000
"""Of one sheet, and of all sheets together."""
MAX_PARTS = 5_000
"""Of a scene, sheets, contact sets and sensors included."""
MAX_POINTS = 100_000
"""Of one profile or motion."""
MAX_PAIRS = 2_000_000
"""Bars times rollers and guides: each pair has a gap, and some twenty numbers more."""
MAX_REST = 20_000_000
"""Bars times bars times rollers and guides, of a scene that starts settled: the search for rest moves every bar and looks at
all pairs, some 240 bytes each (23 GB at 2,000 bars and 24 parts)."""
MAX_STEPS = 1_000_000_000
"""Of a run with steps of one length: they are counted in 32 bits."""
MAX_KEPT = 20_000_000
"""Frames times bars and parts that are kept of a run, or of all runs computed at once: about 200 bytes each."""


def scene_size(scene: Any) -> int:
    """Bars and parts of a sound scene: what is kept of each frame grows with it."""
    bars = sum(int(sheet.bars) for sheet in scene.sheets.values())
    return bars + sum(len(parts) for parts in vars(scene).values() if isinstance(parts, dict))


def rest_problem(bars: int, bodies: int) -> str | None:
    """What is wrong with the size of a scene that starts settled."""
    if bars * bars * bodies <= MAX_REST:
        return None
    most = int((MAX_REST / bodies) ** 0.5)
    return (
        f"sheets: with {bodies} rollers and guides a scene that starts settled must have at most {most} bars, but has {bars}; "
        'initial = "given" starts as written'
    )


def run_problem(duration: float, dt: float | None, frames: int | None, size: int, runs: int = 1) -> str | None:
    """What is wrong with the size of a run: `dt` (s) None where steps are chosen by their error; `size`: bars and parts of
    the scene; `runs`: how many are computed at once."""
    if dt is not None and not duration <= MAX_STEPS * dt:
        return f"duration / dt must be at most {MAX_STEPS:,} steps, but {duration:g} s / {dt:g} s is more"
    most = max(2, MAX_KEPT // (size * runs))
    if frames is not None and frames > most:
        at_once = f", {runs:,} runs at once" if runs > 1 else ""
        return f"frames must be at most {most:,} here ({size:,} bars and parts{at_once}), but is {frames:,}"
    return None
