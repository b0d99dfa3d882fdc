"""Engineering numbers from a scene and its trajectory.

Functions that return arrays are differentiable; `verdict` judges a finished run and needs concrete values of a single
run, `outcome` is the same judgement in numbers. What must be seen in every step (means, peaks, arrivals) comes from
`trajectory.observed`: ask `simulate` for it with `observe=(...)`.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from diffeed.base.names import known_name
from diffeed.input.parts import Contact, Scene, normalise
from diffeed.model.arrays import Model
from diffeed.model.build import build
from diffeed.readings.frames import approach, motion
from diffeed.readings.margin import jam_margin as jam_margin
from diffeed.readings.margin import jam_margins as jam_margins
from diffeed.readings.trajectory import Trajectory
from diffeed.readings.verdict import STATUSES as STATUSES
from diffeed.readings.verdict import Outcome as Outcome
from diffeed.readings.verdict import Verdict as Verdict
from diffeed.readings.verdict import outcome as outcome
from diffeed.readings.verdict import verdict as verdict

SATURATED = 0.95
"""Share of the friction limit above which a contact counts as truly sliding."""
SLOWLY = 30
"""Steps of the fixed point that finds a creep speed, where friction falls with it."""
EDGES = ("lead", "tail")


def _seen(trajectory: Trajectory, name: str, what: str) -> Any:
    if name not in trajectory.observed:
        raise ValueError(f'{what} needs simulate(..., observe=("{name}",))')
    return trajectory.observed[name]


# --- slip -----------------------------------------------------------------------------------------------------------


class Slip(NamedTuple):
    """Slip of one roller, mm/s: roller surface minus sheet along the heading."""

    over_time: Array  # (frames,), 0 while nothing touches
    mean: Array  # over the time in contact
    rms: Array
    floor: Array  # what the friction regularisation alone would give


def slip(scene: Scene, trajectory: Trajectory) -> dict[str, Slip]:
    """Slip per roller, with its creep floor. Needs observe=("nips",)."""
    nips = _seen(trajectory, "nips", "slip")
    floors = creep_floor(scene, trajectory)
    return {
        name: Slip(trajectory.rollers[name].slip, nips[name].slip_mean, nips[name].slip_rms, floors[name])
        for name in trajectory.rollers
    }


def creep_floor(scene: Scene, trajectory: Trajectory) -> dict[str, Array]:
    """Slip (mm/s) that the regularised law needs to carry the mean square friction at the mean normal force.

    Slip below it is a trait of the law, not of the machine: v = vs phi^-1(load / (mu N)), with the load cut at 95 % of the
    limit, beyond which sliding is real. 0 where friction sticks (nothing creeps there) or is not. Needs observe=("nips",).
    """
    nips = _seen(trajectory, "nips", "creep_floor")
    scene = normalise(scene)
    factor = jnp.max(jnp.stack([s.friction_factor for s in scene.sheets.values()]))
    floors = {}
    for name in trajectory.rollers:
        roller, stats = scene.rollers[name], nips[name]
        contact = scene.contacts[roller.contact]
        if contact.friction_law in ("stick", "none"):
            floors[name] = jnp.zeros_like(stats.force_mean)
            continue
        limit = roller.friction * factor * stats.force_mean
        floors[name] = jnp.where(limit > 0, _creep(contact, stats.friction_rms / jnp.where(limit > 0, limit, 1.0)), 0.0)
    return floors


def _creep(contact: Contact, load: Array) -> Array:
    """mm/s at which regularised friction carries a share of the dynamic limit."""

    def inverse(used: Array) -> Array:
        used = jnp.clip(used, 0.0, SATURATED)
        slow = jnp.arctanh(used) if contact.friction_law == "tanh" else used / jnp.sqrt(1.0 - used**2)
        return contact.stick_speed * slow

    if contact.static_ratio is None:
        return inverse(load)

    def nearer(_: int, speed: Array) -> Array:
        share = 1.0 + (contact.static_ratio - 1.0) / (1.0 + (speed / contact.transition_speed) ** 2)
        return inverse(load / share)

    # From below, so that of several speeds the slowest is found.
    return lax.fori_loop(0, SLOWLY, nearer, jnp.zeros_like(load))


# --- path ------------------------------------------------------------------------------------------------------------


def arrival(scene: Scene, trajectory: Trajectory, sheet: str, sensor: str, edge: str = "lead") -> Array:
    """() time (s) at which an edge of a sheet crosses a sensor's gate; infinity if it never does. Needs observe=("arrivals",).

    Raises ValueError for a name that the scene has not, and for an edge other than "lead" and "tail".
    """
    seen = _seen(trajectory, "arrivals", "arrival")
    known_name("sheet", sheet, scene.sheets)
    known_name("sensor", sensor, scene.sensors)
    known_name("edge", edge, EDGES)
    return seen[sheet][sensor][edge]


def progress(scene: Scene, trajectory: Trajectory) -> dict[str, Array]:
    """How far each sheet has moved under its driven rollers, over what they turned: 1 if none slips. Needs observe=("feed",)."""
    feed = _seen(trajectory, "feed", "progress")
    return {name: f.driven / jnp.where(f.commanded == 0, 1.0, f.commanded) for name, f in feed.items()}


def curvature(scene: Scene, trajectory: Trajectory) -> dict[str, Array]:
    """(frames, bars - 1) curvature at each joint, 1/mm, positive where the sheet turns left along its travel."""
    scene = normalise(scene)
    return {
        name: (track.headings[..., :-1] - track.headings[..., 1:]) * scene.sheets[name].bars / scene.sheets[name].length
        for name, track in trajectory.sheets.items()
    }


class Attack(NamedTuple):
    """How the lead edge meets a part."""

    angle: Array  # (frames,) deg between the lead bar's heading and the part's tangent; positive: into the part
    gap: Array  # (frames,) mm from the lead edge's bar to the part
    at_contact: Array  # deg at the first frame of contact; NaN if there is none


def attack_angle(scene: Scene, trajectory: Trajectory, part: str, sheet: str | None = None) -> Attack:
    """Attack angle of a sheet's head (of the first sheet if None) at a roller or guide (its name). Raises ValueError for a name
    that the scene has not."""
    scene = normalise(scene)
    model = _static_model(scene)
    names = model.body_names
    known_name("roller or guide", part, set(names))
    sheet = model.layout.names[0] if sheet is None else sheet
    known_name("sheet", sheet, model.layout.names)
    k = model.layout.names.index(sheet)
    feature, rows = model.layout.starts[k] + k, np.flatnonzero(np.array(names) == part)
    gaps, into, _ = (v[:, rows, feature] for v in approach(scene, trajectory.states))
    nearest = jnp.argmin(gaps, axis=1)[:, None]
    gap, sine = (jnp.take_along_axis(v, nearest, axis=1)[:, 0] for v in (gaps, into))
    angle = jnp.rad2deg(jnp.arcsin(jnp.clip(sine, -1.0, 1.0)))
    # Differentiable: the index of the first contact is found, the angle there is read.
    first = jnp.argmax(gap < 0)
    return Attack(angle, gap, jnp.where(jnp.any(gap < 0), angle[first], jnp.nan))


class PairGaps(NamedTuple):
    """Signed gaps of every pair, mm, negative in contact."""

    gap: Array  # (frames, bodies, features)
    bodies: tuple[str, ...]  # a guide's own face and its two tips are bodies of the same name
    features: tuple[str, ...]  # "film.3": bar 3 with its front end circle, or the smooth skin at node 3; "film.tail"


def pair_gaps(scene: Scene, trajectory: Trajectory) -> PairGaps:
    """Gap of every body to every feature of every sheet, touching or not: no dead gradient before contact."""
    scene = normalise(scene)
    model = _static_model(scene)
    layout = model.layout
    names = [f"{s}.{k}" for s, n in zip(layout.names, layout.bars, strict=True) for k in (*range(n), "tail")]
    bodies = model.body_names
    if not bodies:
        return PairGaps(jnp.zeros((len(trajectory.time), 0, len(names))), (), tuple(names))
    return PairGaps(approach(scene, trajectory.states).gap, bodies, tuple(names))


def _static_model(scene: Scene) -> Model:
    """The model of a normalised scene for its names and counts: nothing is computed."""
    return jax.eval_shape(build, scene)


# --- energy ---------------------------------------------------------------------------------------------------------


def energy(scene: Scene, trajectory: Trajectory) -> dict[str, Array]:
    """Stored energies over frames, N mm: kinetic, bending, gravity, contact, springs and their total."""
    stored = motion(normalise(scene), trajectory.states).stored._asdict()
    return stored | {"total": sum(stored.values(), jnp.zeros(()))}


def energy_balance(scene: Scene, trajectory: Trajectory) -> dict[str, Array]:
    """Where the work of the drives (and of loads, if there are any) went, N mm: change of stored energy, each loss, and what
    the step itself lost (`numerical`: an implicit step damps; it shrinks with dt). What moving guides, rollers and clamps put
    in is not told apart: it counts as won there. What friction that sticks holds for a while (below mu F stick_displacement
    per contact) counts as lost in friction, and as won back. Needs observe=("energy",)."""
    work = _seen(trajectory, "energy", "energy_balance")
    stored = work["stored"]
    losses = {f"lost in {k}": work[k] for k in ("friction", "contact", "joints", "rollers")}
    put_in = {"work of drives": work["drives"]} | ({"work of loads": work["loads"]} if scene.loads else {})
    numerical = sum(put_in.values()) - stored - sum(losses.values(), jnp.zeros(()))
    return put_in | {"stored": stored} | losses | {"numerical": numerical}
