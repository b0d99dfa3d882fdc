"""From what a sample draws to its scene: every input moves its number, its part or its climate."""

import jax.numpy as jnp
from jax import Array

import diffeed
from optimize import variables as free
from optimize.tolerance import media
from optimize.tolerance.draws import Input


def sampled(inputs: tuple[Input, ...], scene: diffeed.Scene, deviation: Array) -> diffeed.Scene:
    """The scene with every input off by its deviation, (inputs,), which may be traced.

    Climates come first, wherever they stand: they set a sheet's numbers, about which other inputs of that sheet scatter.
    """
    for given, by in sorted(zip(inputs, deviation, strict=True), key=lambda pair: pair[0].climate is None):
        scene = _moved(scene, given, by)
    return scene


def _moved(scene: diffeed.Scene, given: Input, by: Array) -> diffeed.Scene:
    if given.climate is not None:
        sheet, card, base = given.climate
        return media.move_climate(scene, sheet, card, base + by)
    for path in given.what.paths:
        old = diffeed.get(scene, path)
        share = jnp.exp(by) if given.of.kind == "log_normal" else 1.0 + by
        scene = diffeed.put(scene, path, old * share if given.share else old + by)
    return free.moved(scene, given.what, by)
