"""Stacks of scenes for `vmap`."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from diffeed.input.parts import Profile, Scene, normalise


def stack(scenes: list[Scene]) -> Scene:
    """Join scenes of one structure into one whose leaves have a leading axis, (scenes, ...); `jax.vmap(simulate)` takes it.

    Shorter profiles repeat their last point. Raises ValueError, naming the path, where structures differ.
    """
    if isinstance(scenes, Scene):
        raise TypeError("stack takes a list of scenes, but this is one scene")
    if not scenes:
        raise ValueError("stack needs at least one scene")
    made = [_flat(s) for s in scenes]
    for k, other in enumerate(made):
        if found := _misfit(made[0], other):
            raise ValueError(f"scenes 0 and {k} do not fit: {found}")
    columns = zip(*([leaf for _, leaf in m.leaves] for m in made), strict=True)
    return jax.tree_util.tree_unflatten(made[0].tree, [_join(list(column)) for column in columns])


def misfit(first: Scene, other: Scene) -> str:
    """What keeps two scenes from one stack, by path: the first thing besides numbers in which they differ. Empty if nothing."""
    return _misfit(_flat(first), _flat(other))


class _Flat(NamedTuple):
    """A normalised scene and its leaves by path; a profile is one leaf."""

    scene: Scene
    leaves: list[tuple[Any, Any]]
    tree: Any


def _flat(scene: Scene) -> _Flat:
    made = normalise(scene)
    return _Flat(made, *jax.tree_util.tree_flatten_with_path(made, is_leaf=_is_profile))


def _misfit(first: _Flat, other: _Flat) -> str:
    if first.tree != other.tree:
        return _first_difference(first.scene, other.scene)
    for (path, a), (_, b) in zip(first.leaves, other.leaves, strict=True):
        if _is_profile(a) != _is_profile(b):
            return f"{_name(path)} is {_kind(a)} in one and {_kind(b)} in the other"
        if not _is_profile(a) and a.shape != b.shape:
            return f"{_name(path)} has shape {a.shape} in one and {b.shape} in the other"
    return ""


def _is_profile(value: Any) -> bool:
    return isinstance(value, Profile)


def _join(column: list[Any]) -> Any:
    if _is_profile(column[0]):
        points = max(v.times.shape[0] for v in column)
        return Profile(
            times=jnp.stack([_extend(v.times, points) for v in column]),
            values=jnp.stack([_extend(v.values, points) for v in column]),
        )
    return jnp.stack(column)


def _extend(values: jax.Array, points: int) -> jax.Array:
    return jnp.concatenate([values, jnp.repeat(values[-1:], points - values.shape[0])])


def _name(path: tuple[Any, ...]) -> str:
    keys = (getattr(p, "name", None) or getattr(p, "key", None) or getattr(p, "idx", "") for p in path)
    return ".".join(str(k) for k in keys)


def _first_difference(a: Any, b: Any, path: str = "") -> str:
    """The first path at which two scenes differ in kind, name or static value."""
    before = f"{path}." if path else ""
    if type(a) is not type(b):
        return f"{path} is {_kind(a)} in one and {_kind(b)} in the other"
    if isinstance(a, dict):
        for name in sorted(set(a) ^ set(b)):
            return f"{before}{name} is only in one of them"
        pairs = [(f"{before}{k}", a[k], b[k]) for k in sorted(a)]
    elif hasattr(a, "__dataclass_fields__"):
        for f in a.__dataclass_fields__.values():
            mine, other = getattr(a, f.name), getattr(b, f.name)
            if f.metadata.get("role") == "word" and mine != other:
                return f"{before}{f.name} is {mine!r} in one and {other!r} in the other"
        pairs = [(f"{before}{k}", getattr(a, k), getattr(b, k)) for k in a.__dataclass_fields__]
    else:
        return ""
    return next((found for name, x, y in pairs if (found := _first_difference(x, y, name))), "")


def _kind(value: Any) -> str:
    if value is None or isinstance(value, jax.Array):
        return "absent" if value is None else "a number"
    return "a profile" if _is_profile(value) else f"a {type(value).__name__}"
