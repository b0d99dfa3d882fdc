"""Stacks of scenes for `vmap`."""

from typing import Any

import jax
import jax.numpy as jnp

from diffeed.parts import Profile, Scene, normalise


def stack(scenes: list[Scene]) -> Scene:
    """Join scenes of one structure into one whose leaves have a leading axis, (scenes, ...); `jax.vmap(simulate)` takes it.

    Shorter profiles repeat their last point. Raises ValueError, naming the path, where structures differ.
    """
    if not scenes:
        raise ValueError("stack needs at least one scene")
    made = [normalise(s) for s in scenes]
    first_paths, first_tree = jax.tree_util.tree_flatten_with_path(made[0], is_leaf=_is_profile)
    rows = []
    for k, other in enumerate(made):
        paths, tree = jax.tree_util.tree_flatten_with_path(other, is_leaf=_is_profile)
        if tree != first_tree:
            raise ValueError(f"scenes 0 and {k} do not fit: {_first_difference(made[0], other)}")
        rows.append([leaf for _, leaf in paths])
    columns = zip(*rows, strict=True)
    leaves = [_join(list(column), _name(path)) for (path, _), column in zip(first_paths, columns, strict=True)]
    return jax.tree_util.tree_unflatten(first_tree, leaves)


def _is_profile(value: Any) -> bool:
    return isinstance(value, Profile)


def _join(column: list[Any], path: str) -> Any:
    if any(_is_profile(v) for v in column):
        if not all(_is_profile(v) for v in column):
            raise ValueError(f"{path} is a profile in some scenes and a number in others")
        points = max(v.times.shape[0] for v in column)
        return Profile(
            times=jnp.stack([_extend(v.times, points) for v in column]),
            values=jnp.stack([_extend(v.values, points) for v in column]),
        )
    shapes = {v.shape for v in column}
    if len(shapes) > 1:
        raise ValueError(f"{path} has different shapes: {', '.join(map(str, sorted(shapes)))}")
    return jnp.stack(column)


def _extend(values: jax.Array, points: int) -> jax.Array:
    return jnp.concatenate([values, jnp.repeat(values[-1:], points - values.shape[0])])


def _name(path: tuple[Any, ...]) -> str:
    keys = (getattr(p, "name", None) or getattr(p, "key", None) or getattr(p, "idx", "") for p in path)
    return ".".join(str(k) for k in keys)


def _first_difference(a: Any, b: Any, path: str = "scene") -> str:
    """The first path at which two scenes differ in kind, name or static value."""
    if type(a) is not type(b):
        return f"{path} is {_kind(a)} in one and {_kind(b)} in the other"
    if isinstance(a, dict):
        for name in sorted(set(a) ^ set(b)):
            return f"{path}.{name} is only in one of them"
        pairs = [(f"{path}.{k}", a[k], b[k]) for k in sorted(a)]
    elif hasattr(a, "__dataclass_fields__"):
        for f in a.__dataclass_fields__.values():
            mine, other = getattr(a, f.name), getattr(b, f.name)
            if f.metadata.get("role") == "word" and mine != other:
                return f"{path}.{f.name} is {mine!r} in one and {other!r} in the other"
        pairs = [(f"{path}.{k}", getattr(a, k), getattr(b, k)) for k in a.__dataclass_fields__]
    else:
        return ""
    return next((found for name, x, y in pairs if (found := _first_difference(x, y, name))), "")


def _kind(value: Any) -> str:
    return "absent" if value is None else f"a {type(value).__name__}"
