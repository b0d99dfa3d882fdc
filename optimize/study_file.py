"""STUDY files: TOML to a checked study. A file holds numbers and words; the scene it names is read as a scene file."""

import os
from importlib import resources
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from diffeed.base import toml_text
from diffeed.base.names import hint
from diffeed.base.toml_text import TomlError
from diffeed.base.words import key_text, short
from optimize.asked import StudyError
from optimize.study import Goal, Limit, Medium, Robust, Search, Stage, Study, Variable
from optimize.tolerance.records import Tolerance

MAX_BYTES = 1_000_000
_RECORDS: dict[str, type[BaseModel]] = {
    "variables": Variable, "objective": Goal, "limits": Limit, "media": Medium, "search": Search, "stages": Stage,
    "tolerances": Tolerance, "robust": Robust,
}  # fmt: skip


def load_study(name_or_path: str | os.PathLike[str]) -> Study:
    """The study of a shipped study's name or of a TOML file; StudyError lists everything that is wrong with it.

    Relative paths of scene and measured values count from the study file.
    """
    where = os.fspath(name_or_path)
    table, _ = read_table(where)
    if is_tolerance(table):
        raise StudyError(
            ["this is a tolerance study (it has tolerances, no variables): python -m optimize tolerance runs it"], where
        )
    return make_study(table, where)


def is_tolerance(table: dict[str, Any]) -> bool:
    """Whether a table is a tolerance study: numbers scatter and none is searched for."""
    return "tolerances" in table and "variables" not in table


def read_table(where: str) -> tuple[dict[str, Any], Path]:
    """The plain table of a shipped study or of a TOML file, the paths in it made whole; and the file's folder."""
    shipped = shipped_studies()
    file = shipped.get(where, Path(where))
    table = _parse(file, where, sorted(shipped))
    if "sheets" in table and "scene" not in table:
        raise StudyError([f'this is a scene, not a study; a study names it: scene = "{Path(where).name}"'], where)
    scene = table.get("scene")
    if isinstance(scene, str) and not os.path.isabs(scene):
        beside = file.parent / scene
        table["scene"] = str(beside) if beside.is_file() else scene
    _find_values(table, file.parent)
    return table, file.parent


def _find_values(table: dict[str, Any], folder: Path) -> None:
    """Make the paths of measured values whole, also of a file that is missing: one of that name may lie where the user is."""
    tolerances = table.get("tolerances")
    for given in tolerances.values() if isinstance(tolerances, dict) else ():
        if isinstance(given, dict) and isinstance(given.get("file"), str):
            given["file"] = str((folder / given["file"]).absolute())


def make_study(table: dict[str, Any], where: str = "study") -> Study:
    """A study from a table of plain values."""
    try:
        return Study.model_validate(table)
    except ValidationError as error:
        raise StudyError([sentence(e, _RECORDS, Study) for e in error.errors()], where) from None


def shipped_studies() -> dict[str, Path]:
    """Name and file of the studies that come with the package."""
    folder = resources.files("optimize") / "studies"
    return {f.name.removesuffix(".toml"): Path(str(f)) for f in folder.iterdir() if f.name.endswith(".toml")}


def shipped_files(name: str) -> dict[str, Path]:
    """That of its scene, if a shipped study has one of its own, and last its own file, by the names that copies must have."""
    shipped = shipped_studies()
    if name not in shipped:
        raise StudyError([f"there is no shipped study of that name; there are: {', '.join(sorted(shipped))}"], name)
    file = shipped[name]
    scene = toml_text.read(file, MAX_BYTES)["scene"]
    own = {scene: file.parent / scene} if (file.parent / scene).is_file() else {}
    return own | {file.name: file}


def _parse(file: Path, where: str, known: list[str]) -> dict[str, Any]:
    try:
        if not file.is_file():
            raise TomlError(f"there is no such file, nor a shipped study of that name: {', '.join(known)}")
        return toml_text.read(file, MAX_BYTES)
    except TomlError as error:
        raise StudyError([str(error)], where) from None
    except (OSError, ValueError):  # a name too long, or with a zero byte in it
        raise StudyError(
            [f"there is no such file, nor a shipped study of that name: {', '.join(known)}"], where
        ) from None


def sentence(error: Any, records: dict[str, type[BaseModel]], whole: type[BaseModel]) -> str:
    """One problem in the words of a study file: path, what it must be, what it is. `records`: by section, for hints."""
    places = _places(error, whole)
    where, kind = ".".join(map(key_text, places)), error["type"]
    if kind == "extra_forbidden":
        section = next((p for p in reversed(places[:-1]) if p in records), "")
        fields = list((records[section] if section else whole).model_fields)
        return f"{where} is not a field here{hint(places[-1], fields)}"
    if kind == "missing":
        return f"{where} is missing"
    text = error["msg"].removeprefix("Value error, ")
    if kind == "value_error":
        return f"{where}: {text}" if where else text
    text = text.removeprefix("Input should be ").replace("Input should have", "something with")
    return f"{where} must be {text}, but is {short(error.get('input'))}"


def _places(error: Any, whole: type[BaseModel]) -> list[str]:
    """Where in the file an error is. Pydantic's place also says which of a field's alternatives it tried (path.str,
    path.list[str].0), and that a name is wrong ([key]); either may be a name in the file as well."""
    loc = error["loc"]
    if loc[-1:] == ("[key]",) and error["type"] != "extra_forbidden":
        loc = loc[:-1]
    places: list[str] = []
    kinds: list[Any] = [whole]
    for place in loc:
        if len(kinds) > 1:
            kinds = [Any]  # it says which of these it tried
        else:
            places.append(str(place))
            kinds = _alternatives(_inside(kinds[0], place))
    return places


def _inside(kind: Any, place: Any) -> Any:
    """What belongs at a place of a record, a table or a list."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return kind.model_fields[place].annotation if place in kind.model_fields else Any
    return (Any, *get_args(kind))[-1]


def _alternatives(kind: Any) -> list[Any]:
    """The kinds of a value that is given."""
    if get_origin(kind) is Annotated:
        return _alternatives(get_args(kind)[0])
    if get_origin(kind) in (Union, UnionType):
        return [a for k in get_args(kind) if k is not NoneType for a in _alternatives(k)]
    return [kind]
