"""Measures that an objective or a limit may name: what each needs from a run, and how it is computed. All differentiable.

To add one: write a function of (scene, run, part, at) and its line in TERMS.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

import diffeed
from diffeed import measures


class Term(NamedTuple):
    """`of`: the section whose parts it is asked for ("rollers", "guides", "sheets", or none); `at`: whether it needs a sensor."""

    value: Callable[[diffeed.Scene, Any, str, str], Array]
    of: str
    unit: str
    doc: str
    observe: tuple[str, ...] = ()
    at: bool = False
    found: Callable[[diffeed.Scene, Any, str, str], Array] | None = None
    """What really came out, where `value` stands in for it to search by: it may be infinite."""


def _slip(scene: diffeed.Scene, run: Any, part: str, at: str) -> Array:
    return jnp.maximum(run.observed["nips"][part].slip_rms - measures.creep_floor(scene, run)[part], 0.0)


def _arrival(scene: diffeed.Scene, run: Any, part: str, at: str) -> Array:
    """The time at which the lead passes the sensor; if it does not, the end of the run and the time that the straight
    way left would take at the commanded speed: so that a jam still says which way is better."""
    time = measures.arrival(scene, run, part, at)
    feed = run.observed["feed"][part]
    left = jnp.sqrt(jnp.sum((scene.sensors[at].position - run.sheets[part].nodes[-1, 0]) ** 2))
    end = run.time[-1]
    speed = jnp.maximum(jnp.abs(feed.commanded), 1.0) / end
    arrived = jnp.isfinite(time)
    return jnp.where(arrived, jnp.where(arrived, time, 0.0), end + left / speed)


def _nip(name: str) -> Callable[..., Array]:
    return lambda scene, run, part, at: getattr(run.observed["nips"][part], name)


def _guide(name: str) -> Callable[..., Array]:
    return lambda scene, run, part, at: getattr(run.observed["guides"][part], name)


def _span(name: str) -> Callable[..., Array]:
    return lambda scene, run, part, at: getattr(run.observed["spans"][part], name)


TERMS: dict[str, Term] = {
    "slip": Term(_slip, "rollers", "mm/s", "RMS slip above the creep floor", ("nips",)),
    "slip_rms": Term(_nip("slip_rms"), "rollers", "mm/s", "RMS slip", ("nips",)),
    "nip_force": Term(_nip("force_mean"), "rollers", "N", "mean normal force in contact", ("nips",)),
    "nip_force_peak": Term(_nip("force_peak"), "rollers", "N", "largest normal force", ("nips",)),
    "guide_force": Term(_guide("force_mean"), "guides", "N", "mean normal force of the sheets in contact", ("guides",)),
    "guide_force_peak": Term(_guide("force_peak"), "guides", "N", "largest normal force of the sheets", ("guides",)),
    "friction": Term(_nip("friction_rms"), "rollers", "N", "RMS friction on the sheet", ("nips",)),
    "torque": Term(_nip("torque_mean"), "rollers", "N mm", "mean torque of its contacts on it", ("nips",)),
    "torque_peak": Term(_nip("torque_peak"), "rollers", "N mm", "largest torque of its contacts on it", ("nips",)),
    "arrival": Term(
        _arrival, "sheets", "s", "time at which the lead passes a sensor", ("arrivals", "feed"), True, measures.arrival
    ),
    "progress": Term(
        lambda scene, run, part, at: measures.progress(scene, run)[part], "sheets", "1", "fed over commanded", ("feed",)
    ),
    "fed": Term(
        lambda scene, run, part, at: run.observed["feed"][part].fed, "sheets", "mm", "distance fed", ("feed",)
    ),
    "curvature": Term(
        lambda scene, run, part, at: run.observed["curvature"][part], "sheets", "1/mm", "largest curvature", ("curvature",)
    ),
    "buckling": Term(
        _span("buckling"), "sheets", "1", "compression between nips over the Euler load", ("spans",)
    ),
    "tension": Term(_span("tension_peak"), "sheets", "N", "peak tension between nips", ("spans",)),
    "jam_margin": Term(
        lambda scene, run, part, at: measures.jam_margin(scene, run, part), "sheets", "1", "distance from a jam",
        ("feed", "spans"),
    ),
    "drive_work": Term(
        lambda scene, run, part, at: run.observed["energy"]["drives"], "", "N mm", "work of the drives", ("energy",)
    ),
    "lead_x": Term(
        lambda scene, run, part, at: run.sheets[part].nodes[-1, 0, 0], "sheets", "mm", "lead edge at the end, x"
    ),
    "lead_y": Term(
        lambda scene, run, part, at: run.sheets[part].nodes[-1, 0, 1], "sheets", "mm", "lead edge at the end, y"
    ),
}  # fmt: skip
