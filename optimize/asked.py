"""What a study asks of a run: measures looked up in TERMS, parts and sensors in the scene, and their values."""

import inspect
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

import diffeed
from diffeed.base.limits import run_problem, scene_size
from diffeed.base.names import hint, nearest
from diffeed.base.records import fields
from diffeed.base.words import quoted, short
from optimize.records import Limit, Measured, Runs
from optimize.terms import TERMS, Term


class StudyError(ValueError):
    """A study that cannot be used; `problems` lists everything that is wrong with it."""

    def __init__(self, problems: list[str], where: str = "study") -> None:
        super().__init__(problems, where)
        self.problems, self.where = list(problems), where

    def __str__(self) -> str:
        count = "1 problem" if len(self.problems) == 1 else f"{len(self.problems)} problems"
        return "\n".join([f"{self.where}: {count}", *(f"  {p}" for p in self.problems)])


class Asked(NamedTuple):
    """One term of the objective or one limit, resolved."""

    name: str
    term: Term
    parts: tuple[str, ...]
    at: str
    spec: Any  # Goal, Limit or Measured


def values_of(asked: tuple[Asked, ...], scene: diffeed.Scene, run: Any, found: bool = False) -> Array:
    """(terms,) each the mean over its parts: what a search goes by, or what was really `found` (infinite for what never
    happened)."""
    values = []
    for a in asked:
        term = a.term.found if found and a.term.found else a.term.value
        values.append(jnp.mean(jnp.stack([jnp.asarray(term(scene, run, part, a.at)) for part in a.parts])))
    return jnp.stack(values) if values else jnp.zeros((0,))


def violations(limits: tuple[Asked, ...], values: Array) -> Array:
    """(sides,) how far each limit is broken, in its scale; negative where it is kept."""
    found = []
    for value, asked in zip(values, limits, strict=True):
        spec = asked.spec
        assert isinstance(spec, Limit)
        if spec.at_least is not None:
            found.append((spec.at_least - value) / spec.scale)
        if spec.at_most is not None:
            found.append((value - spec.at_most) / spec.scale)
    return jnp.stack(found) if found else jnp.zeros((0,))


def by_limit(limits: tuple[Asked, ...], sides: np.ndarray) -> np.ndarray:
    """(..., sides) -> (..., limits): how far each limit is broken, by the worse of its sides."""
    of = [k for k, a in enumerate(limits) for end in (a.spec.at_least, a.spec.at_most) if end is not None]
    found = np.full((*sides.shape[:-1], len(limits)), -np.inf)
    for side, k in enumerate(of):
        found[..., k] = np.maximum(found[..., k], sides[..., side])
    return found


def changed(scene: diffeed.Scene, changes: dict[str, Any], where: str, problems: list[str]) -> diffeed.Scene:
    """The scene with numbers replaced by path; what does not fit is added to `problems`."""
    for path, value in changes.items():
        try:
            scene = diffeed.put(scene, path, value)
        except ValueError as error:
            problems.append(f"{where}: {error}")
    return scene


def shown(value: Any) -> str:
    """A value in a message."""
    return f"{np.size(value)} numbers" if np.ndim(value) else "nothing" if value is None else short(value)


def number_at(scene: diffeed.Scene, path: str) -> float:
    """The number at a path. ValueError for a path that leads nowhere, or to anything but one number."""
    value = diffeed.get(scene, path)
    diffeed.unit(scene, path)
    if np.ndim(value) or np.asarray(value).dtype.kind not in "fi":  # a vector, a profile, or nothing
        raise ValueError(f"path must name one number, but {path} holds {shown(value)}")
    return float(value)


def run_problems(study: Runs, scene: diffeed.Scene, where: str, problems: list[str], runs: int = 1) -> None:
    """Add what `diffeed.check` finds in a scene that is to be run as a study asks; `runs` are computed at once."""
    if study.duration is not None:
        scene = diffeed.put(scene, "duration", study.duration)
    dt, method, tolerance = study.stepping["dt"], study.method, study.step_tolerance
    found = diffeed.check(scene, dt, method, tolerance, study.frames)
    if not found and (problem := run_problem(scene.duration, None, study.frames, scene_size(scene), runs)):
        found = [problem]
    problems += [f"{where}: {p}" if where else p for p in found]


def refuse_runs(study: Runs, scenes: dict[str, diffeed.Scene]) -> None:
    """ValueError, with where, for scenes that cannot be run as a study asks."""
    problems: list[str] = []
    for where, scene in scenes.items():
        run_problems(study, scene, where, problems)
    if problems:
        raise ValueError("; ".join(problems))


def resolved(section: str, name: str, spec: Measured, scene: diffeed.Scene, problems: list[str]) -> Asked | None:
    """Look up measure, parts and sensor; None, and a line in `problems`, where something does not fit."""
    where = f"{section}.{name}"
    if spec.measure not in TERMS:
        problems.append(
            f"{where}.measure must be one of {', '.join(TERMS)}, but is {quoted(spec.measure)}{nearest(spec.measure, TERMS)}"
        )
        return None
    term, before = TERMS[spec.measure], len(problems)
    problems += _term_problems(spec.measure, term)
    if len(problems) > before:
        return None
    parts = _parts(where, term, spec, scene, problems)
    if term.at and spec.at not in scene.sensors:
        known = ", ".join(sorted(scene.sensors)) or "none in this scene"
        problems.append(
            f"{where}.at must name a sensor ({known}), but is {'missing' if not spec.at else repr(spec.at)}"
        )
    if not term.at and spec.at:
        problems.append(f'{where}.at is only for arrivals; "{spec.measure}" takes none')
    return Asked(name, term, parts, spec.at or "", spec) if len(problems) == before else None


def _term_problems(name: str, term: Term) -> Iterator[str]:
    """What is wrong with a term of the user's own: said before anything is compiled."""
    sections = [f.name for f in fields(diffeed.Scene) if f.metadata.get("many")]
    if term.of not in ("", *sections):
        known = f'"" or one of {", ".join(sections)}'
        yield f'TERMS["{name}"].of must be {known}, but is {quoted(str(term.of))}{nearest(term.of, sections)}'
    try:
        inspect.signature(term.value).bind(None, None, "", "")
    except TypeError:
        yield f'TERMS["{name}"].value must take (scene, run, part, at), but takes {inspect.signature(term.value)}'


def _parts(where: str, term: Term, spec: Measured, scene: diffeed.Scene, problems: list[str]) -> tuple[str, ...]:
    if not term.of:
        if spec.of:
            problems.append(f'{where}.of must be left out: "{spec.measure}" is of the whole machine')
        return ("",)
    known = getattr(scene, term.of)
    named = [spec.of] if isinstance(spec.of, str) else list(spec.of or ())
    if not named and term.of == "sheets":
        named = [min(known)]
    if not named:
        problems.append(f"{where}.of must name one or more {term.of}: {', '.join(sorted(known))}")
    for part in named:
        if part not in known:
            problems.append(f"{where}.of: there is no {quoted(part)} among the {term.of}{hint(part, known)}")
    return tuple(named)
