"""Engineering numbers from a scene and its trajectory.

Functions that return arrays are differentiable; `verdict` judges a finished run and
needs concrete values of a single run. What must be seen in every step (means, peaks, arrivals) comes from
`trajectory.observed`: ask `simulate` for it with `observe=(...)`.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.energy import Energies, energies
from diffeed.kinematics import to_nodes
from diffeed.margin import FOLDED
from diffeed.margin import jam_margin as jam_margin
from diffeed.margin import jam_margins as jam_margins
from diffeed.model import Model, build, is_driven
from diffeed.observe import commanded_speed
from diffeed.parts import Scene, normalise
from diffeed.snapshot import look
from diffeed.state import State, mean_per_sheet
from diffeed.trajectory import Trajectory

SATURATED = 0.95
"""Share of the friction limit above which a contact counts as truly sliding."""


def _seen(trajectory: Trajectory, name: str, what: str) -> Any:
    if name not in trajectory.observed:
        raise ValueError(f'{what} needs simulate(..., observe=("{name}",))')
    return trajectory.observed[name]


class _Motion(NamedTuple):
    """What energies and the verdict read off frames, (frames, ...)."""

    stored: Energies
    speed: Array  # (sheets,) mm/s: each sheet along itself
    wanted: Array  # (sheets,) mm/s: what its driven rollers command


@jax.jit
def _motion(scene: Scene, states: State) -> _Motion:
    model = build(scene)

    def at_frame(state: State) -> _Motion:
        at, world, touching = look(model, state)
        speed = mean_per_sheet(model.layout, at.vx * at.c + at.vy * at.s)
        return _Motion(energies(model, state, at, touching), speed, commanded_speed(model, at, touching, world.spin))

    return jax.lax.map(at_frame, states)


@jax.jit
def _approach(scene: Scene, states: State) -> tuple[Array, Array]:
    """Gap (mm) and sine of the angle between each bar's heading and each body, (frames, bodies, features)."""
    model = build(scene)

    def at_frame(state: State) -> tuple[Array, Array]:
        at, _, touching = look(model, state)
        pairs = touching.sheets
        assert pairs is not None
        c, s = (to_nodes(model.layout, v, v)[None, :] for v in (at.c, at.s))
        return pairs.gap, -(c * pairs.nx + s * pairs.ny)

    return jax.lax.map(at_frame, states)


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
    limit, beyond which sliding is real. Needs observe=("nips",).
    """
    nips = _seen(trajectory, "nips", "creep_floor")
    scene = normalise(scene)
    factor = jnp.max(jnp.stack([s.friction_factor for s in scene.sheets.values()]))
    floors = {}
    for name in trajectory.rollers:
        roller, stats = scene.rollers[name], nips[name]
        contact = scene.contacts[roller.contact]
        limit = roller.friction * factor * stats.force_mean
        used = jnp.clip(stats.friction_rms / jnp.where(limit > 0, limit, 1.0), 0.0, SATURATED)
        inverse = jnp.arctanh(used) if contact.friction_law == "tanh" else used / jnp.sqrt(1.0 - used**2)
        floors[name] = jnp.where(limit > 0, contact.stick_speed * inverse, 0.0)
    return floors


# --- path ------------------------------------------------------------------------------------------------------------


def arrival(trajectory: Trajectory, sheet: str, sensor: str, edge: str = "lead") -> Array:
    """Time (s) at which the lead or tail crosses a sensor's gate; infinity if it never does. Needs observe=("arrivals",)."""
    return _seen(trajectory, "arrivals", "arrival")[sheet][sensor][edge]


def progress(scene: Scene, trajectory: Trajectory) -> dict[str, Array]:
    """Fed over commanded distance per sheet: 1 for ideal feeding. Needs observe=("feed",)."""
    feed = _seen(trajectory, "feed", "progress")
    return {name: f.fed / jnp.where(f.commanded == 0, 1.0, f.commanded) for name, f in feed.items()}


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
    """Attack angle of a sheet's head at a roller or guide (its name)."""
    scene = normalise(scene)
    model = _static_model(scene)
    names = model.body_names
    if part not in names:
        raise ValueError(f"no roller or guide named {part!r}; known: {', '.join(sorted(set(names)))}")
    sheet = model.layout.names[0] if sheet is None else sheet
    k = model.layout.names.index(sheet)
    feature, rows = model.layout.starts[k] + k, np.flatnonzero(np.array(names) == part)
    gaps, into = (v[:, rows, feature] for v in _approach(scene, trajectory.states))
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
    features: tuple[str, ...]  # "film.3": bar 3 with its front end circle; "film.tail"


def pair_gaps(scene: Scene, trajectory: Trajectory) -> PairGaps:
    """Gap of every body to every feature of every sheet, touching or not: no dead gradient before contact."""
    scene = normalise(scene)
    model = _static_model(scene)
    layout = model.layout
    names = [f"{s}.{k}" for s, n in zip(layout.names, layout.bars, strict=True) for k in (*range(n), "tail")]
    bodies = model.body_names
    if not bodies:
        return PairGaps(jnp.zeros((len(trajectory.time), 0, len(names))), (), tuple(names))
    return PairGaps(_approach(scene, trajectory.states)[0], bodies, tuple(names))


def _static_model(scene: Scene) -> Model:
    """The model of a normalised scene for its names and counts: nothing is computed."""
    return jax.eval_shape(build, scene)


# --- energy ---------------------------------------------------------------------------------------------------------


def energy(scene: Scene, trajectory: Trajectory) -> dict[str, Array]:
    """Stored energies over frames, N mm: kinetic, bending, gravity, contact, springs and their total."""
    stored = _motion(normalise(scene), trajectory.states).stored._asdict()
    return stored | {"total": sum(stored.values(), jnp.zeros(()))}


def energy_balance(scene: Scene, trajectory: Trajectory) -> dict[str, Array]:
    """Where the work of the drives went, N mm: change of stored energy, each loss, and what the step itself lost
    (`numerical`: an implicit step damps; it shrinks with dt). Needs observe=("energy",)."""
    work = dict(_seen(trajectory, "energy", "energy_balance"))
    total = energy(scene, trajectory)["total"]
    stored = total[-1] - total[0]
    losses = {f"lost in {k}": work[k] for k in ("friction", "contact", "joints", "rollers")}
    numerical = work["drives"] - stored - sum(losses.values(), jnp.zeros(()))
    return {"work of drives": work["drives"], "stored": stored} | losses | {"numerical": numerical}


# --- verdict --------------------------------------------------------------------------------------------------------


class Verdict(NamedTuple):
    """passed, jammed, late (still moving, but the goal is not reached) or failed (numerically)."""

    status: str
    reason: str
    time: float | None
    place: str

    def sentence(self) -> str:
        when = "" if self.time is None else f" at {self.time:.4g} s"
        where = f", {self.place}" if self.place else ""
        return f"{self.status}{when}: {self.reason}{where}"


STALLED = 0.1
"""Share of the commanded speed below which a sheet stands still."""
STRAYED = 50.0
"""mm outside the box around all parts that counts as having left the path."""


def verdict(scene: Scene, trajectory: Trajectory) -> Verdict:
    """Judge a finished run, the worst sheet first. A scene's `goal` names the sensor that each tail must pass."""
    if not bool(trajectory.ok):
        failure = trajectory.failure
        return Verdict("failed", failure.describe(), float(failure.time), "")
    scene = normalise(scene)
    motion = _motion(scene, trajectory.states)
    verdicts = [
        _judge_sheet(scene, trajectory, name, np.asarray(motion.speed)[:, k], np.asarray(motion.wanted)[:, k])
        for k, name in enumerate(sorted(scene.sheets))
    ]
    return max(verdicts, key=lambda v: ("passed", "late", "jammed").index(v.status))


def _judge_sheet(scene: Scene, trajectory: Trajectory, name: str, speed: np.ndarray, wanted: np.ndarray) -> Verdict:
    track, time = trajectory.sheets[name], np.asarray(trajectory.time)
    nodes = np.asarray(track.nodes)
    done = _passed_goal(scene, trajectory, name)
    if done is not None:
        return Verdict("passed", f"the tail of {name} passed {scene.goal}", done, "")
    if (k := _first(_is_folded(np.asarray(track.headings)))) is not None:
        return Verdict("jammed", f"{name} folded back on itself", float(time[k]), _place(scene, trajectory, name, k))
    if (k := _first(_has_strayed(scene, nodes))) is not None:
        return Verdict("jammed", f"{name} left the path", float(time[k]), _place(scene, trajectory, name, k))
    if any(is_driven(r) for r in scene.rollers.values()) and (k := _stalled_since(speed, wanted, nodes)) is not None:
        held = np.abs(wanted[k:]).max() > 0
        reason = f"{name} stalled" if held else f"{name} stalled: no driven roller holds it"
        return Verdict("jammed", reason, float(time[k]), _place(scene, trajectory, name, k))
    if scene.goal:
        return Verdict(
            "late", f"the tail of {name} has not reached {scene.goal} at the end of the run", float(time[-1]), ""
        )
    return Verdict("passed", f"{name} was moving freely at the end", None, "")


def _first(flags: np.ndarray) -> int | None:
    found = np.flatnonzero(flags)
    return int(found[0]) if len(found) else None


def _passed_goal(scene: Scene, trajectory: Trajectory, name: str) -> float | None:
    """Time at which the tail passed the goal: exact if arrivals were observed, else from the frames."""
    if not scene.goal:
        return None
    if "arrivals" in trajectory.observed:
        at = float(arrival(trajectory, name, scene.goal, "tail"))
        return at if np.isfinite(at) else None
    sensor = scene.sensors[scene.goal]
    way = np.asarray(sensor.direction) / np.linalg.norm(np.asarray(sensor.direction))
    offset = np.asarray(trajectory.sheets[name].nodes)[:, -1] - np.asarray(sensor.position)
    along, across = offset @ way, np.abs(offset @ np.array([-way[1], way[0]]))
    crossed = (along[:-1] < 0) & (along[1:] >= 0) & (across[1:] < float(sensor.range))
    k = _first(crossed)
    return None if k is None else float(trajectory.time[k + 1])


def _is_folded(headings: np.ndarray) -> np.ndarray:
    """(frames,) bool."""
    span = min(3, headings.shape[1] - 1)
    if span < 1:
        return np.zeros(len(headings), bool)
    return (np.abs(headings[:, span:] - headings[:, :-span]) > FOLDED).any(axis=1)


def _has_strayed(scene: Scene, nodes: np.ndarray) -> np.ndarray:
    points = _points(scene)
    if not len(points):
        return np.zeros(len(nodes), bool)
    # A sheet that starts outside the parts (on a table that is not modelled) has not strayed there.
    points = np.concatenate([points, nodes[0]])
    low, high = points.min(axis=0) - STRAYED, points.max(axis=0) + STRAYED
    length = np.linalg.norm(nodes[0, 0] - nodes[0, -1])
    lead = nodes[:, 0]
    out = ((lead < low - length) | (lead > high + length)).any(axis=1)
    # Ahead of the last roller a sheet may hang out by its length; sideways, it may not fall out of the machine.
    return out | (nodes[:, :, 1].max(axis=1) < low[1])


def _points(scene: Scene) -> np.ndarray:
    """Corners of the boxes around all rollers and guides."""
    found = []
    for part in (*scene.rollers.values(), *scene.guides.values()):
        if hasattr(part, "start"):
            found += [np.asarray(part.start), np.asarray(part.end)]
        else:
            center, radius = np.asarray(part.center), float(part.radius)
            found += [center - radius, center + radius]
    return np.array(found).reshape(-1, 2)


def _stalled_since(speed: np.ndarray, wanted: np.ndarray, nodes: np.ndarray) -> int | None:
    """Frame since which the sheet has stood still until the end (for at least a twentieth of the run)."""
    reference = np.abs(wanted).max()
    if reference == 0.0:
        return None
    moving = np.flatnonzero(np.abs(speed) >= STALLED * reference)
    since = int(moving[-1]) + 1 if len(moving) else 0
    return since if len(speed) - since >= max(2, len(speed) // 20) else None


def _place(scene: Scene, trajectory: Trajectory, name: str, frame: int) -> str:
    """Where the lead edge is at a frame, and the part nearest to it."""
    model = _static_model(scene)
    lead = np.asarray(trajectory.sheets[name].nodes)[frame, 0]
    where = f"lead edge at ({lead[0]:.1f}, {lead[1]:.1f}) mm"
    if not model.has_bodies:
        return where
    k = model.layout.names.index(name)
    gap = np.asarray(_approach(scene, trajectory.states)[0])[frame, :, model.layout.starts[k] + k]
    return f"{where}, nearest part {model.body_names[int(np.argmin(np.abs(gap)))]}"
