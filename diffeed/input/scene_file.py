"""Scene files: TOML to records and back. A file holds numbers and words; it names no other file and runs nothing."""

import importlib.resources
import json
import os
from collections.abc import Iterator
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np

from diffeed.base import toml_text
from diffeed.base.files import write_whole
from diffeed.base.limits import MAX_PARTS
from diffeed.base.names import hint, nearest
from diffeed.base.records import fields, is_required
from diffeed.base.toml_text import TomlError
from diffeed.base.words import key_text
from diffeed.input.check_records import SceneError, check_records, checked
from diffeed.input.check_values import VARYING, Field, quote, show
from diffeed.input.parts import SECTIONS, Profile, Scene, normalise

MAX_BYTES = 10_000_000
MOST_PROBLEMS = 200
"""Unknown fields that are told one by one: for each the nearest known one is looked up."""


def load_scene(name_or_path: str | os.PathLike[str]) -> Scene:
    """The scene of a shipped scene's name or of a TOML file; SceneError lists everything that is wrong with it."""
    where = os.fspath(name_or_path)
    return _scene(_parse(_find(where), where), where)


def read_scene(text: str) -> Scene:
    """The scene of a scene file's text, as `scene_text` writes it. SceneError lists everything that is wrong with it."""
    return scene_of(text.encode("utf-8", "surrogatepass"), "scene")


def scene_of(data: bytes, where: str) -> Scene:
    """The scene of a scene file's bytes; `where` names it in a SceneError."""
    return _scene(_decode(data, where), where)


def _scene(table: dict[str, Any], where: str) -> Scene:
    if "scene" in table and "sheets" not in table:
        raise SceneError(["this is a study, not a scene; the scene that it names is in its `scene`"], where)
    problems: list[str] = []
    scene = _read(Scene, "", table, problems)
    problems += check_records(scene)
    if problems:
        raise SceneError(problems, where)
    return normalise(scene)


def shipped_scenes() -> dict[str, str]:
    """Name and first comment paragraph of every scene that comes with the package."""
    return {name: _first_comment(file.read_text(encoding="utf-8")) for name, file in sorted(_shipped().items())}


def shipped_text(name: str) -> str:
    """The file of a shipped scene, comments and all; SceneError if there is none of that name."""
    shipped = _shipped()
    if name not in shipped:
        like = nearest(name, shipped)
        raise SceneError(
            [f"there is no shipped scene of that name{like}; there are: {', '.join(sorted(shipped))}"], name
        )
    return shipped[name].read_text(encoding="utf-8")


def save_scene(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write a scene so that `load_scene` gives back the same bits; a file is replaced whole or not at all. SceneError, and
    nothing written, if something is wrong with the scene."""
    write_whole(path, scene_text(scene))


def scene_text(scene: Scene) -> str:
    """The scene file of a scene: required fields and those that differ from their default."""
    return "\n".join(_record_lines("", "", checked(scene))).lstrip("\n") + "\n"


def _shipped() -> dict[str, Traversable]:
    folder = importlib.resources.files("diffeed") / "scenes"
    return {f.name.removesuffix(".toml"): f for f in folder.iterdir() if f.name.endswith(".toml")}


def _first_comment(text: str) -> str:
    lines: list[str] = []
    for line in text.splitlines():
        if not line.startswith("#") or not line.strip("# "):
            break
        lines.append(line.strip("# "))
    return " ".join(lines)


# Reading


def _find(where: str) -> Traversable:
    shipped = _shipped()
    if where in shipped:
        return shipped[where]
    try:
        if Path(where).is_file():
            return Path(where)
    except (OSError, ValueError):  # a name too long, or with a zero byte in it
        pass
    known = ", ".join(sorted(shipped))
    like = nearest(where, shipped)
    raise SceneError([f"there is no such file, nor a shipped scene of that name{like}; shipped scenes: {known}"], where)


def _parse(file: Traversable, where: str) -> dict[str, Any]:
    try:
        return toml_text.read(file, MAX_BYTES)
    except TomlError as error:
        raise SceneError([str(error)], where) from None


def _decode(data: bytes, where: str) -> dict[str, Any]:
    try:
        return toml_text.decode(data, MAX_BYTES)
    except TomlError as error:
        raise SceneError([str(error)], where) from None


def _read(kind: type, path: str, table: dict[str, Any], problems: list[str]) -> Any:
    """A record of raw values; unknown keys are reported and dropped, missing fields become None for the check."""
    known = {f.name: f for f in fields(kind)}
    for key in table:
        if key not in known and len(problems) < MOST_PROBLEMS:
            problems.append(f"{_join(path, key)} is not a field of {kind.__name__}{hint(key, known)}")
    given = [f for f in known.values() if f.name in table or is_required(f)]
    return kind(**{f.name: _read_value(_join(path, f.name), f, table.get(f.name), problems) for f in given})


def _read_value(path: str, field: Field, value: Any, problems: list[str]) -> Any:
    if not isinstance(value, dict):
        return value
    if field.metadata["role"] == "part":
        if field.metadata["many"]:
            return dict(_read_section(path, value, problems))
        return _read(field.metadata["kinds"][0], path, value, problems)
    return _read(Profile, path, value, problems) if field.name in VARYING else value


def _read_section(section: str, table: dict[str, Any], problems: list[str]) -> Iterator[tuple[str, Any]]:
    kinds = SECTIONS[section]
    if len(table) > MAX_PARTS:
        problems.append(f"{section} must hold at most {MAX_PARTS} parts, but holds {len(table)}")
        return
    for name, part in table.items():
        path, word = _join(section, name), next(iter(kinds))
        if not isinstance(part, dict):
            yield name, part
            continue
        if len(kinds) > 1:
            word, part = part.get("kind"), {k: v for k, v in part.items() if k != "kind"}
        if isinstance(word, str) and word in kinds:
            yield name, _read(kinds[word], path, part, problems)
        else:
            problems.append(_kind_problem(path, word, kinds))


def _kind_problem(path: str, word: Any, kinds: dict[str, type]) -> str:
    if word is None:
        return f"{path}.kind is missing: it must be {quote(kinds)}"
    return f"{path}.kind must be {quote(kinds)}, but is {show(word)}{nearest(word, kinds)}"


def _join(path: str, name: str) -> str:
    return f"{path}.{key_text(name)}" if path else key_text(name)


# Writing


def _record_lines(path: str, word: str, record: Any) -> Iterator[str]:
    """The lines of a record: its own values first, as TOML wants, then a table for each part in it."""
    if path:
        yield f"\n[{path}]"
    if word:
        yield f"kind = {json.dumps(word)}"
    parts = []
    for f in fields(record):
        value = getattr(record, f.name)
        if f.metadata["role"] == "part":
            parts.append((_join(path, f.name), value))
        elif is_required(f) or not _is_default(value, f):
            yield f"{f.name} = {_value_text(value, f)}"
    for where, value in parts:
        yield from _part_lines(where, value)


def _part_lines(path: str, value: Any) -> Iterator[str]:
    if not isinstance(value, dict):
        yield from _record_lines(path, "", value) if value is not None else ()
        return
    kinds = SECTIONS[path]
    words = {kind: word for word, kind in kinds.items()} if len(kinds) > 1 else {}
    for name, part in value.items():
        yield from _record_lines(f"{path}.{name}", words.get(type(part), ""), part)


def _is_default(value: Any, field: Field) -> bool:
    """Compared as text, since -0.0 equals 0.0 but is another number."""
    default = field.default
    if value is None or default is None or isinstance(value, Profile):
        return value is default
    if field.metadata["role"] == "number":
        default = np.asarray(default, dtype=value.dtype)
    return _value_text(value, field) == _value_text(default, field)


def _value_text(value: Any, field: Field) -> str:
    if isinstance(value, Profile):
        inner = (f"{f.name} = {_value_text(getattr(value, f.name), f)}" for f in fields(value))
        return "{" + ", ".join(inner) + "}"
    if field.metadata["role"] == "number" or field.metadata["type"] is float:
        return _number_text(np.asarray(value))
    return json.dumps(value) if isinstance(value, (str, bool)) else str(int(value))


def _number_text(value: np.ndarray) -> str:
    if value.ndim:
        return "[" + ", ".join(_number_text(v) for v in value) + "]"
    return repr(float(str(value)))  # str: the shortest text of its own precision, so that float32 stays short
