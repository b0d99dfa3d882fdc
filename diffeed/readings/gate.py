"""When a sheet's tail crosses the gate of the scene's goal, between the frames of a run."""

import jax.numpy as jnp
from jax import Array

from diffeed.base.products import product
from diffeed.input.parts import Scene
from diffeed.readings.trajectory import Trajectory


def crosses(scene: Scene, trajectory: Trajectory, name: str, sense: float) -> Array:
    """(frames - 1,) bool: whether between two frames the tail crosses the goal's gate, along its direction (`sense` 1) or
    against it (-1)."""
    through, across = passes(scene, trajectory, name, sense)
    return through & (across < scene.sensors[scene.goal].range)


def passes(scene: Scene, trajectory: Trajectory, name: str, sense: float) -> tuple[Array, Array]:
    """The same for the whole line of the gate, and how far beside the sensor, mm."""
    sensor = scene.sensors[scene.goal]
    way = sense * sensor.direction / jnp.sqrt(jnp.sum(sensor.direction**2))
    offset = trajectory.sheets[name].nodes[:, -1] - sensor.position[None]
    along, across = product(offset, way), jnp.abs(offset[:, 1] * way[0] - offset[:, 0] * way[1])
    return (along[:-1] < 0) & (along[1:] >= 0), across[1:]
