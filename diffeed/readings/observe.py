"""What can be accumulated in every step of a run, paid only when asked for: frames alone alias peaks and RMS values.

An observer starts, looks at each step, and closes. To add one: write the three functions and name it in `OBSERVERS`.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from diffeed.base.products import product
from diffeed.base.records import number, record, replace
from diffeed.base.smooth import divide
from diffeed.chain.kinematics import Pose, nodes, pose
from diffeed.chain.state import State, mean_per_sheet
from diffeed.contact.features import by_feature
from diffeed.contact.kept import Kept, keep_all, part, pick
from diffeed.contact.sweep import heading
from diffeed.forces.contacts import Contacts
from diffeed.forces.energy import Powers, energies, powers
from diffeed.input.parts import Scene
from diffeed.model.arrays import Model
from diffeed.readings import pressed_guides, spans
from diffeed.readings.snapshot import (
    Pressed,
    gaps_to_bodies,
    gaps_to_guides,
    guide_names,
    look,
    on_rollers,
    roller_order,
)
from diffeed.readings.trajectory import Parts


class Seen(NamedTuple):
    """One step: states before and after, and a look at the state before (shafts at its own time). Its `share` (s) of an integral
    is half of this step and of the one before: the trapezoidal rule."""

    before: State
    after: State
    h: Array
    share: Array
    touching: Contacts
    kept: Kept  # the pairs that were looked at: all, or those that may touch


class End:
    """Where a run ended, and the `share` (s) of that look. The contacts, of all pairs, are looked at once for all that ask."""

    def __init__(self, model: Model, state: State, share: Array) -> None:
        self.model, self.state, self.share = model, state, share

    @functools.cached_property
    def touching(self) -> Contacts:
        return look(self.model, self.state)[2]


class Observer(NamedTuple):
    """start(model, scene, state); update(model, scene, sums, seen); close(model, scene, sums, end).

    `far`: whether it needs to see all pairs, or those alone that may touch.
    """

    start: Callable[..., Any]
    update: Callable[..., Any]
    close: Callable[..., Any]
    far: bool = False


# --- nips: slip and forces per roller -----------------------------------------------------------------------------------


@record
class NipSums:
    """Running sums per roller, (rollers,) in sorted order."""

    time: Any
    slip: Any
    slip2: Any
    force: Any
    force_peak: Any
    friction: Any
    friction2: Any
    torque: Any
    torque_peak: Any


@record
class NipStats:
    """Per roller over the time in which it touched a sheet; zeros if it never did."""

    contact_time: Any = number(unit="s", doc="time in contact")
    slip_mean: Any = number(unit="mm/s", doc="mean slip, roller minus sheet along the heading")
    slip_rms: Any = number(unit="mm/s", doc="root mean square slip")
    force_mean: Any = number(unit="N", doc="mean normal force")
    force_peak: Any = number(unit="N", doc="largest normal force")
    friction_mean: Any = number(unit="N", doc="mean friction on the sheet along its heading")
    friction_rms: Any = number(unit="N", doc="root mean square friction")
    torque_mean: Any = number(unit="N mm", doc="mean torque of its contacts on it")
    torque_peak: Any = number(unit="N mm", doc="largest magnitude of that torque")


NIP_WORDS = {
    "contact_time": "contact",
    "slip_mean": "slip mean",
    "slip_rms": "slip RMS",
    "force_mean": "normal mean",
    "force_peak": "normal peak",
    "torque_mean": "torque mean",
}
"""Short names of what is reported of a nip."""


def nip_unit(field: str) -> str:
    """The unit of a field of `NipStats`."""
    return NipStats.__dataclass_fields__[field].metadata["unit"]  # type: ignore[attr-defined]


def _nips_start(model: Model, scene: Scene, state: State) -> NipSums:
    zero = jnp.zeros((model.rollers.n,))
    return NipSums(**{name: zero for name in NipSums.__dataclass_fields__})  # type: ignore[attr-defined]


def _nips_update(model: Model, scene: Scene, sums: NipSums, seen: Seen) -> NipSums:
    return _nips_add(sums, on_rollers(model, seen.touching, seen.kept), seen.share)


def _nips_add(sums: NipSums, now: Pressed, share: Array) -> NipSums:
    h = jnp.where(now.force > 0, share, 0.0)
    return NipSums(
        time=sums.time + h,
        slip=sums.slip + h * now.slip,
        slip2=sums.slip2 + h * now.slip**2,
        force=sums.force + h * now.force,
        force_peak=jnp.maximum(sums.force_peak, now.force),
        friction=sums.friction + h * now.friction,
        friction2=sums.friction2 + h * now.friction**2,
        torque=sums.torque + h * now.torque,
        torque_peak=jnp.maximum(sums.torque_peak, jnp.where(now.force > 0, jnp.abs(now.torque), 0.0)),
    )


def _root(x: Array) -> Array:
    """Square root with gradient 0 at 0 (a roller that never slipped)."""
    return jnp.where(x > 0, jnp.sqrt(jnp.where(x > 0, x, 1.0)), 0.0)


def _nips_close(model: Model, scene: Scene, sums: NipSums, end: End) -> Parts[NipStats]:
    sums = _nips_add(sums, on_rollers(model, end.touching, keep_all(model)), end.share)
    t = sums.time
    block = NipStats(
        contact_time=t,
        slip_mean=divide(sums.slip, t),
        slip_rms=_root(divide(sums.slip2, t)),
        force_mean=divide(sums.force, t),
        force_peak=sums.force_peak,
        friction_mean=divide(sums.friction, t),
        friction_rms=_root(divide(sums.friction2, t)),
        torque_mean=divide(sums.torque, t),
        torque_peak=sums.torque_peak,
    )
    return Parts(block=block, names=tuple(sorted(model.rollers.names)))


# --- arrivals: lead and tail at sensors -----------------------------------------------------------------------------


@record
class Arrivals:
    """Times (s) at which edges cross the sensors' gates, infinity if never; (sheets, sensors), both sorted by name."""

    lead: Any
    tail: Any
    ends: Any  # (2, 2, sheets): x, y of lead and tail at the last look
    time: Any


def _ends(model: Model, at: Pose) -> Array:
    x, y = nodes(model, at)
    cuts = [(s.start + k, s.stop + k) for k, s in enumerate(model.layout.slices())]
    lead, tail = ([c[i] for c in cuts] for i in (0, 1))
    return jnp.stack([jnp.stack([v[jnp.array(i)] for i in (lead, tail)]) for v in (x, y)])


def _arrivals_start(model: Model, scene: Scene, state: State) -> Arrivals:
    never = jnp.full((len(model.layout.names), len(scene.sensors)), jnp.inf, state.time.dtype)
    return Arrivals(lead=never, tail=never, ends=_ends(model, pose(model, state)), time=state.time)


def _arrivals_look(scene: Scene, past: Arrivals, ends: Array, time: Array) -> Arrivals:
    times = {"lead": [], "tail": []}
    for name in sorted(scene.sensors):
        sensor = scene.sensors[name]
        way = sensor.direction / jnp.sqrt(sensor.direction[0] ** 2 + sensor.direction[1] ** 2)
        p = sensor.position
        was = (past.ends[0] - p[0]) * way[0] + (past.ends[1] - p[1]) * way[1]
        dx, dy = ends[0] - p[0], ends[1] - p[1]
        now, off = dx * way[0] + dy * way[1], jnp.abs(dy * way[0] - dx * way[1])
        crossed = (was < 0) & (now >= 0) & (off < sensor.range)
        at = past.time + (time - past.time) * divide(-was, now - was)
        for row, edge in enumerate(("lead", "tail")):
            times[edge].append(jnp.where(crossed[row], at[row], jnp.inf))
    if not scene.sensors:
        return past
    lead, tail = (jnp.stack(times[e], axis=1) for e in ("lead", "tail"))
    # The first crossing counts; an arrival once made is kept.
    keep = [jnp.where(jnp.isfinite(a), a, b) for a, b in ((past.lead, lead), (past.tail, tail))]
    return Arrivals(lead=keep[0], tail=keep[1], ends=ends, time=time)


def _arrivals_update(model: Model, scene: Scene, past: Arrivals, seen: Seen) -> Arrivals:
    return _arrivals_look(scene, past, _ends(model, seen.touching.at), seen.before.time)


def _arrivals_close(model: Model, scene: Scene, past: Arrivals, end: End) -> dict[str, dict[str, dict[str, Array]]]:
    done = _arrivals_look(scene, past, _ends(model, pose(model, end.state)), end.state.time)
    return {
        sheet: {
            name: {"lead": done.lead[i, j], "tail": done.tail[i, j]} for j, name in enumerate(sorted(scene.sensors))
        }
        for i, sheet in enumerate(model.layout.names)
    }


# --- energy: work and losses --------------------------------------------------------------------------------------------


@record
class EnergySums:
    """Time integrals of powers."""

    work: Any  # Powers, N mm
    begun: Any  # N mm stored at the start


def _energy_start(model: Model, scene: Scene, state: State) -> EnergySums:
    none = Powers(*[jnp.zeros(())] * len(Powers._fields))
    return EnergySums(work=none, begun=_stored(model, state, look(model, state)[2]))


def _stored(model: Model, state: State, touching: Contacts) -> Array:
    return jnp.sum(jnp.stack(energies(model, state, touching, keep_all(model))))


def _energy_add(sums: EnergySums, now: Powers, share: Array) -> EnergySums:
    return replace(sums, work=jax.tree.map(lambda work, power: work + share * power, sums.work, now))


def _energy_update(model: Model, scene: Scene, sums: EnergySums, seen: Seen) -> EnergySums:
    return _energy_add(sums, powers(model, seen.before, seen.touching, seen.kept), seen.share)


def _energy_close(model: Model, scene: Scene, sums: EnergySums, end: End) -> dict[str, Array]:
    done = _energy_add(sums, powers(model, end.state, end.touching, keep_all(model)), end.share)
    return done.work._asdict() | {"stored": _stored(model, end.state, end.touching) - sums.begun}


# --- gaps, curvature, feed ----------------------------------------------------------------------------------------------


@record
class Gaps:
    """Smallest signed gap of any sheet to each part, mm."""

    gap: Any = number(unit="mm", doc="smallest gap so far")


def _gaps_now(model: Model, touching: Contacts) -> tuple[Array, Array]:
    if touching.sheets is None:
        return jnp.zeros((0,)), jnp.zeros((0,))
    gap = gaps_to_bodies(model, touching.sheets)
    return gap[: model.rollers.n][roller_order(model)], gaps_to_guides(model, gap)


def _gaps_start(model: Model, scene: Scene, state: State) -> tuple[Array, Array]:
    return jnp.full((model.rollers.n,), jnp.inf), jnp.full((len(guide_names(model)),), jnp.inf)


def _gaps_update(model: Model, scene: Scene, least: tuple[Array, Array], seen: Seen) -> tuple[Array, Array]:
    rollers, guides = _gaps_now(model, seen.touching)
    return jnp.minimum(least[0], rollers), jnp.minimum(least[1], guides)


def _gaps_close(model: Model, scene: Scene, least: tuple[Array, Array], end: End) -> dict[str, Parts[Gaps]]:
    now = _gaps_now(model, end.touching)
    rollers, guides = (jnp.minimum(a, b) for a, b in zip(least, now, strict=True))
    return {
        "rollers": Parts(block=Gaps(gap=rollers), names=tuple(sorted(model.rollers.names))),
        "guides": Parts(block=Gaps(gap=guides), names=guide_names(model)),
    }


def bends(model: Model, state: State) -> list[Array]:
    """Per sheet, (bars - 1,): angle of each joint, rad."""
    return [state.heading[s][:-1] - state.heading[s][1:] for s in model.layout.slices()]


def _curvature_now(model: Model, state: State) -> Array:
    largest = [jnp.max(jnp.abs(b), initial=0.0) for b in bends(model, state)]
    lengths = [2.0 * model.bars.half_length[s.start] for s in model.layout.slices()]
    return jnp.stack([b / n for b, n in zip(largest, lengths, strict=True)])


def _curvature_start(model: Model, scene: Scene, state: State) -> Array:
    return _curvature_now(model, state)


def _curvature_update(model: Model, scene: Scene, most: Array, seen: Seen) -> Array:
    return jnp.maximum(most, _curvature_now(model, seen.after))


def _curvature_close(model: Model, scene: Scene, most: Array, end: End) -> dict[str, Array]:
    return {name: most[k] for k, name in enumerate(model.layout.names)}


@record
class Feed:
    """Distances so far, mm, (sheets,)."""

    fed: Any = number(unit="mm", doc="distance that the sheet has moved along itself")
    driven: Any = number(unit="mm", doc="distance that it has moved under the driven rollers in contact that turn")
    commanded: Any = number(unit="mm", doc="distance that the driven rollers in contact have turned")
    longest_stall: Any = number(unit="s", doc="longest time at less than a tenth of the commanded speed")
    stall: Any = number(unit="s", doc="time of the present stall")


def _driven(model: Model, touching: Contacts, kept: Kept) -> tuple[Array, Array, Array]:
    """Of the kept pairs with circles: by how much driven rollers press, kg mm/s2, and that times their surface speed along the
    heading of the sheet, and times the speed of the sheet there."""
    n, circles, near = model.rollers.n, len(model.circle_names), slice(kept.n_circles)
    assert touching.sheets is not None
    pairs, of_near = jax.tree.map(lambda v: v[near], touching.sheets), part(kept.pairs, kept.pairs, near)
    c, s = heading(model, touching.at, pairs, of_near)
    driven, speed = np.zeros(circles), jnp.zeros((circles,)).at[:n].set(touching.spin * model.rollers.radius)
    driven[:n] = model.rollers.driven
    force = pairs.touch.force * pick(jnp.asarray(driven, pairs.gap.dtype), kept.circle_index)
    along, speed = pairs.nx * s - pairs.ny * c, pick(speed, kept.circle_index)
    return force, force * along * speed, force * along * (speed + pairs.v_t)


def commanded_speed(model: Model, touching: Contacts, kept: Kept) -> tuple[Array, Array]:
    """(sheets,) mm/s: surface speed along the heading of the driven rollers that touch a sheet, weighted by force; and that
    force, kg mm/s2."""
    wanted, _, force = speeds_at_drives(model, touching, kept)
    return wanted, force


def speeds_at_drives(model: Model, touching: Contacts, kept: Kept) -> tuple[Array, Array, Array]:
    """The same, and between the two the speed of the sheet there."""
    if touching.sheets is None or model.rollers.n == 0:
        nothing = jnp.zeros((len(model.layout.names),))
        return nothing, nothing, nothing
    force, pull, moved = _driven(model, touching, kept)
    # One product instead of slices: each slice would compute the contact law again.
    own = jnp.asarray(model.layout.sheet_of_feature, pull.dtype)
    of_near = part(kept.pairs, kept.pairs, slice(kept.n_circles))
    pull, moved, force = product(by_feature(model, (pull, moved, force), of_near), own)
    return divide(pull, force), divide(moved, force), force


def surface_speeds(model: Model, touching: Contacts) -> Array:
    """(sheets, rollers) mm/s: surface speed along the heading of each driven roller that touches a sheet, else 0; of contacts
    that hold every body."""
    n = model.rollers.n
    if touching.sheets is None or n == 0:
        return jnp.zeros((len(model.layout.names), n))
    force, pull, _ = (v[:n] for v in _driven(model, touching, keep_all(model)))
    own = jnp.asarray(model.layout.sheet_of_feature, pull.dtype)
    return divide(product(pull, own), product(force, own)).T


def _feed_start(model: Model, scene: Scene, state: State) -> Feed:
    zero = jnp.zeros((len(model.layout.names),))
    return Feed(fed=zero, driven=zero, commanded=zero, longest_stall=zero, stall=zero)


def _feed_update(model: Model, scene: Scene, feed: Feed, seen: Seen) -> Feed:
    return _feed_add(model, feed, seen.touching, seen.kept, seen.share)


def _feed_add(model: Model, feed: Feed, touching: Contacts, kept: Kept, share: Array) -> Feed:
    at = touching.at
    speed = mean_per_sheet(model.layout, at.vx * at.c + at.vy * at.s)
    wanted, there, _ = speeds_at_drives(model, touching, kept)
    stalled = (jnp.abs(wanted) > 0) & (speed * jnp.sign(wanted) < 0.1 * jnp.abs(wanted))
    stall = jnp.where(stalled, feed.stall + share, 0.0)
    return Feed(
        fed=feed.fed + share * speed,
        driven=feed.driven + jnp.where(wanted != 0, share * there, 0.0),
        commanded=feed.commanded + share * wanted,
        longest_stall=jnp.maximum(feed.longest_stall, stall),
        stall=stall,
    )


def _feed_close(model: Model, scene: Scene, feed: Feed, end: End) -> dict[str, Feed]:
    feed = _feed_add(model, feed, end.touching, keep_all(model), end.share)
    names = Feed.__dataclass_fields__  # type: ignore[attr-defined]
    return {
        sheet: replace(feed, **{name: getattr(feed, name)[k] for name in names})
        for k, sheet in enumerate(model.layout.names)
    }


OBSERVERS: dict[str, Observer] = {
    "nips": Observer(_nips_start, _nips_update, _nips_close),
    "guides": Observer(pressed_guides.start, pressed_guides.update, pressed_guides.close),
    "arrivals": Observer(_arrivals_start, _arrivals_update, _arrivals_close),
    "energy": Observer(_energy_start, _energy_update, _energy_close),
    "gaps": Observer(_gaps_start, _gaps_update, _gaps_close, far=True),
    "curvature": Observer(_curvature_start, _curvature_update, _curvature_close),
    "feed": Observer(_feed_start, _feed_update, _feed_close),
    "spans": Observer(spans.start, spans.update, spans.close),
}
