"""A TOLERANCE study made ready: scene, inputs, measures and limits looked up and checked, and how a sample becomes a scene."""

import functools
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
from jax import Array
from pydantic import ValidationError

import diffeed
from diffeed.base.names import nearest
from optimize.asked import Asked, StudyError, changed, number_at, resolved, run_problems
from optimize.records import Limit, Measured
from optimize.study_file import read_table, sentence
from optimize.tolerance import media
from optimize.tolerance.draws import Input, cards_of, inputs_of, key_of
from optimize.tolerance.records import Axis, Latitude, Tolerance, ToleranceStudy

RECORDS = {
    "tolerances": Tolerance, "measures": Measured, "limits": Limit, "latitude": Latitude, "x": Axis, "y": Axis,
}  # fmt: skip
"""Records by the section that holds them, for messages."""
MOST_NUMBERS = 100_000_000
"""Deviations of a study, samples times inputs: 0.8 GB, drawn before the first run."""


@dataclass(frozen=True)
class ToleranceProblem:
    """A checked study. `scene`: normalised, with the media of the study in it."""

    study: ToleranceStudy
    scene: diffeed.Scene
    inputs: tuple[Input, ...]
    measures: tuple[Asked, ...]
    limits: tuple[Asked, ...]
    cards: dict[str, tuple[media.Card, float]]

    @property
    def asked(self) -> tuple[Asked, ...]:
        """Measures, then limits: the columns of what is recorded."""
        return (*self.measures, *self.limits)

    @property
    def observe(self) -> tuple[str, ...]:
        return tuple(sorted({o for a in self.asked for o in a.term.observe}))

    def changed(self, **fields: Any) -> "ToleranceProblem":
        """The same problem with fields of the study replaced, which must be checked already."""
        return replace(self, study=self.study.model_copy(update=fields))

    @functools.cached_property
    def key(self) -> str:
        """Equal for problems whose sample i is the same. The number of samples counts only where the draws depend on it."""
        left_out = {"title", "latitude", "scene"} | ({"samples"} if self.study.sampling != "latin_hypercube" else set())
        study = self.study.as_run(left_out)
        for tolerance in study["tolerances"].values():
            tolerance.pop("cost")
        return key_of(study, self.inputs, (self.scene,))


def load_tolerance(name_or_path: str | os.PathLike[str], **changes: Any) -> ToleranceProblem:
    """The problem of a shipped study's name or of a TOML file, with some of its fields changed; StudyError lists
    everything that is wrong with it. Relative paths of scene and data count from the study file."""
    where = os.fspath(name_or_path)
    table, folder = read_table(where)
    if "variables" in table and "tolerances" not in table:
        raise StudyError(
            [
                "this is a study for a design search (it has variables, no tolerances): python -m optimize design runs it"
            ],
            where,
        )
    return make_tolerance(table | changes, where, folder)


def make_tolerance(
    table: dict[str, Any], where: str = "study", folder: Path | None = None, scene: diffeed.Scene | None = None
) -> ToleranceProblem:
    """A problem from a table of plain values. `scene` replaces the one that the study names."""
    try:
        study = ToleranceStudy.model_validate(table)
    except ValidationError as error:
        raise StudyError([sentence(e, RECORDS, ToleranceStudy) for e in error.errors()], where) from None
    problems: list[str] = []
    try:
        base = diffeed.load_scene(study.scene) if scene is None else scene
    except diffeed.SceneError as error:
        raise StudyError([f"scene: {p}" for p in error.problems], where) from None
    base = changed(base, study.set, "set", problems)
    cards = cards_of(study.media, base, problems)
    for sheet, (card, climate) in cards.items():
        base = media.apply(base, sheet, card, climate)
    inputs = inputs_of(study.tolerances, cards, base, folder or Path(), problems)  # about the values of the card
    measures = [resolved("measures", n, m, base, problems) for n, m in study.measures.items()]
    limits = [resolved("limits", n, m, base, problems) for n, m in study.limits.items()]
    if study.latitude is not None:
        problems += _latitude_problems(study.latitude, base, cards)
    if study.samples * max(1, len(inputs)) > MOST_NUMBERS:
        most = MOST_NUMBERS // len(inputs)
        problems.append(
            f"samples must be at most {most:,} with {len(inputs)} numbers that scatter, but is {study.samples:,}"
        )
    if study.method not in diffeed.METHODS:
        known = ", ".join(diffeed.METHODS)
        problems.append(
            f'method must be one of {known}, but is "{study.method}"{nearest(study.method, diffeed.METHODS)}'
        )
    if not problems:
        run_problems(study, base, "", problems)
    if problems:
        raise StudyError(problems, where)
    kept = (tuple(filter(None, measures)), tuple(filter(None, limits)))
    return ToleranceProblem(study, base, inputs, *kept, cards)


def _latitude_problems(asked: Latitude, scene: diffeed.Scene, cards: dict[str, Any]) -> list[str]:
    """What does not fit; a number or a climate that both axes set would be what the last of them says."""
    x, y = asked.x, asked.y
    found = [p for n in ("x", "y") for p in _axis_problems(f"latitude.{n}", getattr(asked, n), scene, cards)]
    if twice := sorted(set(x.paths) & set(y.paths)):
        found.append(f"latitude.y.path must name other numbers than latitude.x, but names {', '.join(twice)} again")
    if y.climate is not None and x.climate == y.climate:
        found.append(f"latitude.y.climate must name another sheet than latitude.x, but names {y.climate} again")
    return found


def _axis_problems(where: str, axis: Axis, scene: diffeed.Scene, cards: dict[str, Any]) -> list[str]:
    if axis.climate is not None:
        return (
            []
            if axis.climate in cards
            else [f'{where}.climate needs a card: media.{axis.climate} = "copy_paper_80", say']
        )
    found = []
    for path in axis.paths:
        try:
            number_at(scene, path)
        except ValueError as error:
            found.append(f"{where}: {error}")
    return found


def packed(problem: ToleranceProblem) -> dict[str, Any]:
    """Plain values from which `unpacked` makes the same problem on another machine: files are left behind."""
    # Only what was given: with a step_tolerance a dt that is not given is no bound.
    table = problem.study.model_dump(mode="json", exclude_unset=True, exclude_none=True)
    for tolerance in table["tolerances"].values():
        if tolerance.get("kind") == "data":  # deviations are drawn at home: any family will do
            del tolerance["file"], tolerance["column"]
            tolerance |= {"kind": "normal", "sigma": 1.0}
    return {"study": table, "scene": diffeed.scene_text(problem.scene)}


def unpacked(table: dict[str, Any]) -> ToleranceProblem:
    """The problem that was packed."""
    return make_tolerance(table["study"], scene=diffeed.read_scene(table["scene"]))


def at_axes(problem: ToleranceProblem, scene: diffeed.Scene, asked: Latitude, point: Array) -> diffeed.Scene:
    """The scene at a point of a latitude, (2,) of x and y. A climate comes first: the other axis may set one of its numbers."""
    both = zip((asked.x, asked.y), point, strict=True)
    for axis, value in sorted(both, key=lambda pair: pair[0].climate is None):
        scene = _at_axis(problem, scene, axis, value)
    return scene


def _at_axis(problem: ToleranceProblem, scene: diffeed.Scene, axis: Axis, value: Array) -> diffeed.Scene:
    if axis.climate is not None:
        return media.move_climate(scene, axis.climate, problem.cards[axis.climate][0], value)
    for path in axis.paths:
        scene = diffeed.put(scene, path, value)
    return scene


def rest_of(problem: ToleranceProblem) -> Any:
    """The rest state of the nominal scene: samples begin their own search for rest there. None if none is wanted."""
    return jax.block_until_ready(diffeed.settle(problem.scene)) if problem.scene.initial == "settled" else None
