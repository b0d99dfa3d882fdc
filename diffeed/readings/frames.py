"""What is read off the frames of a finished run: one compiled program each, mapped over the frames."""

from typing import NamedTuple

import jax
from jax import Array

from diffeed.chain.state import State, mean_per_sheet
from diffeed.contact.kept import keep_all
from diffeed.contact.sweep import heading
from diffeed.forces.energy import Energies, energies
from diffeed.input.packing import jit_of_scene
from diffeed.input.parts import Scene
from diffeed.model.build import build
from diffeed.readings.observe import commanded_speed, surface_speeds
from diffeed.readings.snapshot import gaps_of_pairs, look


class Feeding(NamedTuple):
    """How sheets are fed, (frames, sheets)."""

    speed: Array  # mm/s, of each along itself
    wanted: Array  # mm/s, what the driven rollers that touch it command
    held: Array  # bool: some driven roller touches it
    surface: Array  # (frames, sheets, rollers) mm/s along the sheet, of each driven roller that touches it, else 0


class Motion(NamedTuple):
    """What energies and the verdict read off frames, (frames, ...)."""

    stored: Energies
    fed: Feeding


@jit_of_scene
def motion(scene: Scene, states: State) -> Motion:
    """Energies and speeds of a normalised scene."""
    model = build(scene)

    def at_frame(state: State) -> Motion:
        at, _, touching = look(model, state)
        speed = mean_per_sheet(model.layout, at.vx * at.c + at.vy * at.s)
        wanted, press = commanded_speed(model, touching, keep_all(model))
        fed = Feeding(speed, wanted, press > 0, surface_speeds(model, touching))
        return Motion(energies(model, state, touching, keep_all(model)), fed)

    return jax.lax.map(at_frame, states)


class Approach(NamedTuple):
    """Every pair of body and feature, (frames, bodies, features)."""

    gap: Array  # mm; infinite for the tip of a guide's end that is joined to another: it touches nothing
    into: Array  # sine of the angle between the bar's heading and the body's face
    weight: Array  # 0..1: share of the contact that the pair carries


@jit_of_scene
def approach(scene: Scene, states: State) -> Approach:
    """How every bar stands to every body of a normalised scene."""
    model = build(scene)

    def at_frame(state: State) -> Approach:
        at, _, touching = look(model, state)
        pairs = touching.sheets
        assert pairs is not None
        c, s = heading(model, at, pairs, None)
        return Approach(gaps_of_pairs(model, pairs), -(c * pairs.nx + s * pairs.ny), pairs.weight)

    return jax.lax.map(at_frame, states)
