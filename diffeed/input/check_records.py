"""Every problem of a scene's records at once, each a sentence that names part and field, the value and what it must be.

The geometry between parts is judged elsewhere; here each value, each record and the names between them.
"""

from collections.abc import Iterator
from typing import Any

from diffeed.base.records import fields
from diffeed.base.words import key_text, name_problem
from diffeed.input.check_rules import RULES, bars_of, size_problems, stack_problems
from diffeed.input.check_values import VARYING, Field, number_problem, show, word_problem
from diffeed.input.parts import Profile, Scene, Sheet, normalise


class SceneError(ValueError):
    """A scene that cannot be used; `problems` lists everything that is wrong with it."""

    def __init__(self, problems: list[str], where: str = "scene") -> None:
        super().__init__(problems, where)  # both in args, so that the error survives pickling
        self.problems = list(problems)
        self.where = where

    def __str__(self) -> str:
        count = "1 problem" if len(self.problems) == 1 else f"{len(self.problems)} problems"
        return "\n".join([f"{self.where}: {count}", *(f"  {p}" for p in self.problems)])


def check_records(scene: Any) -> list[str]:
    """Every problem, in the order of the records; empty for a sound scene.

    Takes records of plain Python values and normalised ones, never raises; values that JAX traces pass unseen.
    """
    if not isinstance(scene, Scene):
        return [f"a Scene is needed, but this is {show(scene)}"]
    # Of a scene that is too large more would take time and memory to look at.
    as_a_whole = [*size_problems(scene), *stack_problems(scene)]
    return as_a_whole or list(_record_problems("", scene, scene))


def checked(scene: Scene) -> Scene:
    """The normalised scene, or a SceneError with everything that is wrong."""
    problems = check_records(scene)
    if problems:
        raise SceneError(problems)
    return normalise(scene)


def make_scene(**parts: Any) -> Scene:
    """`Scene(...)`, checked and normalised: numbers, lists and tuples become arrays. SceneError lists everything that is
    wrong with the records; `diffeed.check` judges the geometry."""
    return checked(Scene(**parts))


def _record_problems(path: str, record: Any, scene: Scene) -> Iterator[str]:
    bars = bars_of(record) if isinstance(record, Sheet) else None
    sizes = {} if bars is None else {"bars": bars}
    for f in fields(record):
        yield from _field_problems(f"{path}.{f.name}" if path else f.name, getattr(record, f.name), f, sizes, scene)
    for rule in RULES[type(record)]:
        yield from rule(path, record, scene)


def _field_problems(path: str, value: Any, field: Field, sizes: dict[str, int], scene: Scene) -> Iterator[str]:
    role = field.metadata["role"]
    if role == "part":
        yield from _parts_problems(path, value, field, scene)
    elif isinstance(value, Profile) and field.name in VARYING:
        yield from _record_problems(path, value, scene)
    else:
        problem = word_problem(path, value, field) if role == "word" else number_problem(path, value, field, sizes)
        if problem:
            yield problem


def _parts_problems(path: str, value: Any, field: Field, scene: Scene) -> Iterator[str]:
    if not field.metadata["many"]:
        if value is not None:
            yield from _part_problems(path, value, field, scene)
    elif not isinstance(value, dict):
        yield f"{path} must be a table of named parts, but is {show(value)}"
    else:
        for name, part in value.items():
            yield from _name_problems(path, name)
            yield from _part_problems(f"{path}.{key_text(name)}", part, field, scene)


def _name_problems(section: str, name: Any) -> Iterator[str]:
    if problem := name_problem(name):
        yield f"{section}: {problem}"


def _part_problems(path: str, part: Any, field: Field, scene: Scene) -> Iterator[str]:
    kinds = field.metadata["kinds"]
    if type(part) in kinds:
        yield from _record_problems(path, part, scene)
        return
    words = " or ".join(kind.__name__ for kind in kinds)
    yield f"{path} must be a {words} (in a file: a table [{path}]), but is {show(part)}"
