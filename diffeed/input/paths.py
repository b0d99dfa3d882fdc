"""Numbers and words of a scene by name: `rollers.pinch_1.preload`, `guides.turn.center[1]`, `gravity[0]`.

An index counts within the field, so that in a batch of scenes `center[1]` is one number for each scene.
"""

import re
import tomllib
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from diffeed.base.names import hint
from diffeed.base.records import fields, replace
from diffeed.input.check_values import measure, show
from diffeed.input.parts import OF_THE_FIELD, SECTIONS, Motion, Profile, Scene

T = TypeVar("T")
LONGEST = 300
"""Characters of a path; it is quoted whole."""
_PATH = re.compile(r"([A-Za-z0-9_]+(?:\.[A-Za-z0-9_]+)*)((?:\[[0-9]{1,9}\])*)")


class PathError(ValueError):
    """A path that leads nowhere in this scene."""


def get(scene: Scene, path: str) -> Any:
    """The value at a path: a number, a vector, a word, a part or a whole section. PathError, a ValueError, says what is
    wrong with a path that leads nowhere, and what there is."""
    names, index = _split(path)
    node, ndim = scene, 0
    for depth, name in enumerate(names):
        ndim = _ndim(node, name)
        node = _child(node, name, ".".join(names[:depth]), path)
    return _get_item(node, index, ndim, path) if index else node


def put(scene: T, path: str, value: Any) -> T:
    """A copy of the scene with another value at a path; the scene itself stays as it is.

    Numbers may be traced and become arrays, words stay static; "none" takes an optional number away. A record at the name of
    a part adds it, `put(scene, "guides.new", LineGuide(...))`; None takes it away. Whether the value is sound, `diffeed.check`
    says. PathError, a ValueError, for a path that leads nowhere and for a word in place of a number.
    """
    names, index = _split(path)
    if isinstance(scene, Scene) and len(names) == 2 and not index and names[0] in SECTIONS:
        return _with_part(scene, names[0], names[1], value, path)
    return _put(scene, names, 0, path, lambda old, f: _changed(old, f, index, value, path))


def _with_part(scene: Any, section: str, name: str, value: Any, path: str) -> Any:
    parts = dict(getattr(scene, section))
    kinds = tuple(SECTIONS[section].values())
    if value is None or (isinstance(value, str) and value == "none"):
        _child(parts, name, section, path)
        del parts[name]
    elif isinstance(value, kinds):
        parts[name] = value
    else:
        if not hasattr(value, "__dataclass_fields__"):
            _child(parts, name, section, path)
        wanted = " or ".join(kind.__name__ for kind in kinds)
        raise PathError(f'"{path}" is a whole part: it must be a {wanted}, or none, but is {show(value)}')
    return replace(_own(scene), **{section: parts})


def _own(node: Any) -> Any:
    """The same record with dictionaries of its own, so that a copy's parts are not those of the original."""
    held = {f.name: getattr(node, f.name) for f in fields(node)}
    return replace(node, **{name: dict(value) for name, value in held.items() if isinstance(value, dict)})


def unit(scene: Scene, path: str) -> str:
    """The unit of the number at a path, "1" if it has none. PathError, a ValueError, for a path that holds no number."""
    names, _ = _split(path)
    get(scene, path)
    node, found = scene, None
    for name in names:
        inner = _field(node, name)
        if inner is not None and not (found is not None and inner.metadata.get("unit") == OF_THE_FIELD):
            found = inner  # a profile's values have the unit of the field that holds it
        node = _children(node)[name]
    if found is None or found.metadata["role"] != "number":
        raise PathError(f'"{path}" is not a number')
    return found.metadata["unit"]


def numbers_at(scene: Scene, path: str) -> Any:
    """The number or vector at a path. PathError, a ValueError, for one that holds a word or a part, or an optional number that is
    not given."""
    unit(scene, path)
    value = get(scene, path)
    if value is None or isinstance(value, Profile):
        raise PathError(f'"{path}" is not a number: it is {"not given" if value is None else "a profile"}')
    return value


def listed_paths(paths: Any) -> tuple[str, ...]:
    """Paths given as a list. PathError for a single one in its place, and for none."""
    if isinstance(paths, str):
        raise PathError(f'paths must be a list of paths, but is one word: write ["{paths}"]')
    if not (listed := tuple(paths)):
        raise PathError("paths names no number: at least one is needed")
    return listed


def numbers(scene: Any) -> dict[str, Any]:
    """Path and value of every number that is given, entry by entry, in the order of the records: of a scene, or of the
    gradient of one."""
    return dict(_walk("", scene))


def assign(scene: T, assignments: Iterable[str]) -> T:
    """A copy of a scene with values changed as PATH=VALUE says, one after the other. Raises PathError."""
    for text in assignments:
        scene = put(scene, *parse_assignment(text))
    return scene


def parse_assignment(text: str) -> tuple[str, Any]:
    """Path and value of `rollers.drive_1.radius=10.2`. Values read as in a scene file; a bare word is a word."""
    path, equals, raw = (t.strip() for t in text.partition("="))
    if not equals or not raw:
        raise PathError(f"an assignment must read PATH=VALUE, but is {show(text)}")
    _split(path)
    return path, _parse_value(raw)


def _parse_value(raw: str) -> Any:
    try:
        table = tomllib.loads(f"value = {raw}")
    except (ValueError, RecursionError):
        return raw
    if set(table) != {"value"}:
        return raw
    value = table["value"]
    return Profile(**value) if isinstance(value, dict) and set(value) == {"times", "values"} else value


def _split(path: str) -> tuple[list[str], tuple[int, ...]]:
    match = _PATH.fullmatch(path) if isinstance(path, str) and len(path) <= LONGEST else None
    if match is None:
        raise PathError(f"a path must read like rollers.pinch_1.preload or guides.turn.center[1], but is {show(path)}")
    return match[1].split("."), tuple(int(i) for i in re.findall(r"[0-9]+", match[2]))


def _children(node: Any) -> dict[str, Any]:
    if isinstance(node, dict):
        return node
    return {f.name: getattr(node, f.name) for f in fields(node)} if hasattr(node, "__dataclass_fields__") else {}


def _child(node: Any, name: str, parent: str, path: str) -> Any:
    known = _children(node)
    if name in known:
        return known[name]
    where = parent or "a scene"
    if homes := [s for s in SECTIONS if isinstance(node, Scene) and name in getattr(node, s)]:
        raise PathError(f'"{path}": a scene has no "{name}"; did you mean "{homes[0]}.{name}"?')
    if not known:
        if not isinstance(node, (dict, Scene)) and not parent:
            raise PathError(f'"{path}" is looked for in a scene, but this is {show(node)}')
        what = "holds nothing" if isinstance(node, dict) or node is None else "has no fields"
        raise PathError(f'"{path}": {where} {what}, so there is no "{name}"')
    raise PathError(f'"{path}": {where} has no "{name}"{hint(name, known)}')


def _field(node: Any, name: str) -> Any:
    return None if isinstance(node, dict) else next((f for f in fields(node) if f.name == name), None)


def _ndim(node: Any, name: str) -> int:
    """How many indices a field takes."""
    f = _field(node, name) if _children(node) else None
    return len(f.metadata.get("shape", ())) if f else 0


def _put(node: Any, names: list[str], depth: int, path: str, change: Callable[[Any, Any], Any]) -> Any:
    name = names[depth]
    child = _child(node, name, ".".join(names[:depth]), path)
    last = depth == len(names) - 1
    new = change(child, _field(node, name)) if last else _put(child, names, depth + 1, path, change)
    return {**node, name: new} if isinstance(node, dict) else replace(_own(node), **{name: new})


def _changed(old: Any, field: Any, index: tuple[int, ...], value: Any, path: str) -> Any:
    if index:
        ndim = len(field.metadata.get("shape", ())) if field else 0
        return _put_item(old, index, ndim, value, path)
    if field is None or field.metadata["role"] == "word":
        return value
    if isinstance(value, str) and value == "none" and field.metadata.get("optional"):
        return None
    return _leaf(value, path)


def _leaf(value: Any, path: str) -> Any:
    """A number as an array; a profile or motion field by field; a word is neither, and what else there is the check judges."""
    if isinstance(value, (Profile, Motion)):
        return replace(value, **{f.name: _leaf(getattr(value, f.name), path) for f in fields(value)})
    if isinstance(value, str):
        raise PathError(f'"{path}" must be a number, but is {show(value)}')
    return value if measure(value) is None else jnp.asarray(value, dtype=jnp.result_type(float))


def _slot(array: Any, index: tuple[int, ...], ndim: int, path: str) -> tuple[Any, ...]:
    """Where an index lies in the last `ndim` axes of an array; JAX itself would clip one that is too large."""
    lengths = array.shape[max(array.ndim - ndim, 0) :] if ndim else ()
    if len(index) > len(lengths) or any(i >= n for i, n in zip(index, lengths, strict=False)):
        shape = " x ".join(str(n) for n in lengths) or "one"
        raise PathError(
            f'"{path}": there are {shape} entries' if lengths else f'"{path}": it is one number, without index'
        )
    return (..., *index, *(slice(None),) * (ndim - len(index)))


def _get_item(value: Any, index: tuple[int, ...], ndim: int, path: str) -> Any:
    if isinstance(value, (jax.Array, np.ndarray)):
        return value[_slot(value, index, ndim, path)]
    for i in index:
        value = _entries(value, i, path)[i]
    return value


def _put_item(old: Any, index: tuple[int, ...], ndim: int, value: Any, path: str) -> Any:
    given = measure(value)
    if given is None:
        raise PathError(f'"{path}" must be a number, but is {show(value)}')
    if isinstance(old, (jax.Array, np.ndarray)):
        slot = _slot(old, index, ndim, path)
        room = np.broadcast_to(0.0, old.shape)[slot].shape
        if given.shape not in ((), room):
            wanted = f"{' x '.join(map(str, room))} numbers" if room else "one number"
            raise PathError(f'"{path}" must be {wanted}, but is {show(value)}')
        return jnp.asarray(old).at[slot].set(value)
    entries = _entries(old, index[0], path)
    new = _put_item(entries[index[0]], index[1:], ndim - 1, value, path) if index[1:] else value
    return type(old)([*entries[: index[0]], new, *entries[index[0] + 1 :]])


def _entries(value: Any, i: int, path: str) -> Any:
    if not isinstance(value, (list, tuple)):
        what = "a profile: name its .values" if isinstance(value, Profile) else show(value)
        raise PathError(f'"{path}": an index needs a vector, but what it holds is {what}')
    if i >= len(value):
        raise PathError(f'"{path}": there are {len(value)} entries')
    return value


def _walk(path: str, node: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(node, dict):
        for name, child in node.items():
            yield from _walk(f"{path}.{name}", child)
        return
    for f in fields(node):
        value, where = getattr(node, f.name), f"{path}.{f.name}" if path else f.name
        if value is None or f.metadata["role"] == "word":
            continue
        if f.metadata["role"] == "part" or isinstance(value, Profile):
            yield from _walk(where, value)
        else:
            yield from _number_entries(where, value, len(f.metadata["shape"]))


def _number_entries(path: str, value: Any, ndim: int) -> Iterator[tuple[str, Any]]:
    shape = np.shape(value)
    for index in np.ndindex(shape[len(shape) - ndim :]):
        yield path + "".join(f"[{i}]" for i in index), _get_item(value, index, ndim, path) if index else value
