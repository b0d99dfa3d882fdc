"""Text of the documentation that is made from the code, so that it cannot drift. `<!-- generated: NAME -->` marks its place.

Every function of PARTS gives Markdown; `field_list` gives the lines that the reference has below a class.
"""

import dataclasses
import inspect
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import click
import numpy as np
from pydantic import BaseModel

import diffeed.cli
import optimize.cli
from diffeed.base import limits
from diffeed.base.records import REQUIRED, fields, is_required
from diffeed.faults.causes import CAUSES, REMEDIES
from diffeed.input.check_values import VARYING
from diffeed.input.parts import OF_THE_FIELD, SECTIONS, Motion, Profile, Scene
from diffeed.readings.observe import Feed, Gaps, NipStats
from diffeed.readings.pressed_guides import GuideStats
from diffeed.readings.spans import SpanStats
from optimize.study import Goal, Limit, Medium, Robust, Search, Stage, Study, Variable
from optimize.terms import TERMS
from optimize.tolerance.records import Axis, Latitude, Measured, Tolerance, ToleranceStudy

MARK = re.compile(r"^<!-- generated: (\w+) -->$", re.M)


def expand(text: str) -> str:
    """A page with its generated parts in place."""
    return MARK.sub(lambda found: PARTS[found[1]](), text)


def pages() -> set[str]:
    """Names of the pages that hold generated text."""
    here = Path(__file__).parent
    found = (p for p in here.rglob("*.md") if "_build" not in p.parts and MARK.search(p.read_text("utf-8")))
    return {p.relative_to(here).with_suffix("").as_posix() for p in found}


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """A Markdown table."""
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in lines) + "\n"


def _plain_doc(held: Any) -> str:
    return inspect.cleandoc(held.__doc__ or "")


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


# --- scene files --------------------------------------------------------------------------------------------------------


def scene_fields() -> str:
    """A heading, the docstring and a table of fields for each record of a scene file."""
    parts = [_record("### The scene itself", Scene)]
    for section, kinds in SECTIONS.items():
        for word, kind in kinds.items():
            chosen = f' with `kind = "{word}"`' if len(kinds) > 1 else ""
            parts.append(_record(f"### {kind.__name__}\n\n`[{section}.NAME]`{chosen}", kind))
    parts.append(_record(f"### Profile\n\nOf {' and '.join(f'`{v}`' for v in VARYING)}, instead of a number", Profile))
    parts.append(
        _record("### Motion\n\n`[rollers.NAME.motion]`, `[guides.NAME.motion]` or `[clamps.NAME.motion]`", Motion)
    )
    return "\n".join(parts)


def _record(head: str, kind: type) -> str:
    rows = [(f"`{f.name}`", f"{_takes(f)}; {_default(f)}", _sentence(f.metadata["doc"])) for f in fields(kind)]
    return f"{head}\n\n{_plain_doc(kind)}\n\n{table(('Field', 'Takes', 'Meaning'), rows)}"


def _takes(field: dataclasses.Field[Any]) -> str:
    meta = field.metadata
    if meta["role"] == "part":
        kinds = " or ".join(f"[{k.__name__}](#{k.__name__.lower()})" for k in meta["kinds"])
        return f"tables by name: {kinds}" if meta["many"] else f"a table: {kinds}"
    if meta["role"] == "word":
        choices = " or ".join(f"`{json.dumps(c)}`" for c in meta["choices"])
        plain = {str: "a word", int: f"1 to {limits.MAX_BARS:,}", float: "a number > 0, s", bool: "`true` or `false`"}
        return choices or plain.get(meta["type"], '`"lead"`, `"tail"` or a number')
    bound = {"positive": " > 0", "nonnegative": " >= 0", "any": ""}[meta["bound"]]
    unit = "" if meta["unit"] in ("1", OF_THE_FIELD) else f", {meta['unit']}"
    profile = ", or a [profile](#profile)" if field.name in VARYING else ""
    return f"{_ENTRY[meta['shape']]}{bound}{unit}{profile}"


_ENTRY = {
    (): "a number",
    (2,): "`[x, y]`",
    ("bars",): "a list, a number for each bar",
    ("points",): "a list of numbers",
    ("points", 2): "a list of `[x, y]`",
}


def _default(field: dataclasses.Field[Any]) -> str:
    if is_required(field):
        return "**required**"
    if field.default is None or field.default is REQUIRED:
        return "optional"
    return f"default `{json.dumps(np.asarray(field.default).tolist())}`"


# --- study files --------------------------------------------------------------------------------------------------------

_DESIGN = {
    "": Study, "variables": Variable, "objective": Goal, "limits": Limit, "search": Search, "search.stages": Stage,
    "media": Medium, "robust": Robust,
}  # fmt: skip
_TOLERANCE = {
    "": ToleranceStudy, "tolerances": Tolerance, "measures": Measured, "limits": Limit, "latitude": Latitude,
    "latitude.x": Axis,
}  # fmt: skip
_ONE = ("search", "robust", "latitude")
"""Sections that are one table, not tables by name."""


def design_fields() -> str:
    """Tables of fields of a design study."""
    return "\n".join(_model("design study", section, kind) for section, kind in _DESIGN.items())


def tolerance_fields() -> str:
    """Tables of fields of a tolerance study."""
    return "\n".join(_model("tolerance study", section, kind) for section, kind in _TOLERANCE.items())


def _model(what: str, section: str, kind: type[BaseModel]) -> str:
    where = f"`[{section}]`" if section in _ONE else f"`[{section}.NAME]`"
    where = {"": "", "search.stages": "`[[search.stages]]`", "latitude.x": "`[latitude.x]` and `[latitude.y]`"}.get(
        section, where
    )
    title = f"### {kind.__name__} of a {what}" if section else f"### The {what} itself"
    rows = [
        (f"`{name}`", f"{_admits(f.annotation, f.metadata)}; {_given(f)}", f.description or "")
        for name, f in kind.model_fields.items()
    ]
    return "\n\n".join([title, where, _plain_doc(kind), table(("Field", "Takes", "Meaning"), rows)])


def _admits(kind: Any, bounds: Any = ()) -> str:
    """An annotation in words."""
    inner, held = get_args(kind), get_origin(kind)
    if hasattr(kind, "__metadata__"):  # Annotated
        return _admits(inner[0], kind.__metadata__)
    if held is Literal:
        return " or ".join(f"`{json.dumps(v)}`" for v in inner)
    if held is dict:
        record = isinstance(inner[1], type) and issubclass(inner[1], BaseModel)
        return f"tables by name: {inner[1].__name__}" if record else "a table of names and values"
    if held is tuple:
        return "two numbers `[a, b]`"
    if held is list:
        return f"a list: {_admits(inner[0])}" if not _is_record(inner[0]) else f"tables: {inner[0].__name__}"
    if inner:  # a union
        return " or ".join(_admits(v, bounds) for v in inner if v is not type(None))
    if _is_record(kind):
        return f"a table: {kind.__name__}"
    return {str: "a word", bool: "`true` or `false`", int: "a whole number", float: "a number"}[kind] + _bounds(bounds)


def _is_record(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _bounds(found: Any) -> str:
    flat = [m for b in found for m in getattr(b, "metadata", [b])]
    words = {"gt": ">", "ge": ">=", "lt": "<", "le": "<=", "max_length": "of at most"}
    return "".join(f" {w} {getattr(m, n)}" for m in flat for n, w in words.items() if getattr(m, n, None) is not None)


def _given(field: Any) -> str:
    if field.is_required():
        return "**required**"
    value = field.get_default(call_default_factory=True)
    empty = value in (None, {}, [], "") or isinstance(value, BaseModel)
    return "optional" if empty else f"default `{json.dumps(value)}`"


def terms() -> str:
    """What a goal or a limit may measure."""
    rows = [(f"`{name}`", t.unit, t.of or "the machine", _sentence(t.doc)) for name, t in TERMS.items()]
    return table(("Measure", "Unit", "Of", "Meaning"), rows)


# --- limits, causes, commands -------------------------------------------------------------------------------------------


def sizes() -> str:
    """The largest scenes and runs, from `diffeed/base/limits.py`."""
    rows = [(name, f"{getattr(limits, name):,}", meaning) for name, meaning in _constants(limits)]
    return table(("Limit", "Largest", "What it counts"), [(f"`{n}`", v, m) for n, v, m in rows])


def _constants(module: Any) -> Iterator[tuple[str, str]]:
    """Names in capitals of a module with the text below each."""
    source = inspect.getsource(module)
    for name, text in re.findall(r'^([A-Z_]+) = [^\n]+\n"""(.*?)"""', source, re.M | re.S):
        yield name, " ".join(text.split())


def causes() -> str:
    """Why a run failed, and what helps."""
    rows = [(_sentence(what), _sentence(remedy)) for what, remedy in zip(CAUSES, REMEDIES, strict=True) if what]
    return table(("What the run says", "What helps"), rows)


def commands() -> str:
    """Help of every command and subcommand."""
    found = [*_command("diffeed", diffeed.cli.main, None), *_command("python -m optimize", optimize.cli.main, None)]
    return "\n".join(found)


_HELP = "--help"


def _command(name: str, command: click.Command, parent: click.Context | None) -> Iterator[str]:
    context = click.Context(command, info_name=name, parent=parent)
    path = context.command_path
    usage = " ".join(command.collect_usage_pieces(context))
    records = [p.get_help_record(context) for p in command.get_params(context)]
    rows = [(f"`{r[0]}`", r[1]) for r in records if r and r[1] and r[0] != _HELP]
    depth = "##" if parent is None else "###"
    yield f"{depth} {path}\n\n```text\n{path} {usage}\n```\n\n{_help(command.help)}\n\n{_help(command.epilog)}\n\n"
    yield table(("Option", "Meaning"), rows) if rows else ""
    if isinstance(command, click.Group):
        for inner in command.list_commands(context):
            yield from _command(inner, command.get_command(context, inner) or command, context)


def _help(text: str | None) -> str:
    """Help text as Markdown: what click keeps as it stands (after a line with \\b) is shown as it stands."""
    pieces = re.split(r"\n*\x08\n", inspect.cleandoc(text or ""))
    shown = [pieces[0].strip()]
    for piece in pieces[1:]:
        kept, _, rest = piece.partition("\n\n")
        first, *lines = kept.strip("\n").split("\n")
        examples = bool(lines) and all(line.startswith("  ") for line in lines)
        shown.append(f"{first}\n\n```text\n{inspect.cleandoc(chr(10).join(lines))}\n```" if examples else kept.strip())
        shown.append(rest.strip())
    return "\n\n".join(s for s in shown if s)


def words() -> str:
    """Names of steppers and observers, and causes of failed runs by number."""
    rows = [
        ("`diffeed.METHODS`", ", ".join(f"`{m}`" for m in diffeed.METHODS)),
        ("`diffeed.OBSERVERS`", ", ".join(f"`{o}`" for o in diffeed.OBSERVERS)),
        ("`diffeed.CAUSES`", "; ".join(f"{i}: {what}" for i, what in enumerate(diffeed.CAUSES) if i)),
    ]
    return table(("", "Names"), rows)


def observed() -> str:
    """What each observer leaves in `run.observed`, by name."""
    kept = (
        ("nips", "[roller]", NipStats),
        ("guides", "[guide]", GuideStats),
        ("feed", "[sheet]", Feed),
        ("spans", "[sheet]", SpanStats),
        ("gaps", '["rollers" or "guides"][part]', Gaps),
    )
    rows = [
        (f"`{name}`{index}", f"`.{f.name}`", f.metadata["unit"], _sentence(f.metadata["doc"]))
        for name, index, kind in kept
        for f in fields(kind)
    ]
    others = [
        (
            "`arrivals`[sheet][sensor]",
            '`["lead"]`, `["tail"]`',
            "s",
            "Time at which that edge crosses the gate; infinity: never",
        ),
        ("`curvature`[sheet]", "", "1/mm", "Largest curvature of any joint so far"),
        ("`energy`", '`["stored"]`', "N mm", "What is stored more than at the start"),
        *(("`energy`", f'`["{name}"]`', "N mm", meaning) for name, meaning in POWERS.items()),
    ]
    return table(("Observer", "Field", "Unit", "Meaning"), rows + others)


POWERS = {
    "drives": "Work of driven shafts",
    "loads": "Work of dead forces and moments",
    "friction": "What friction takes, lost in sliding or lent to deflections",
    "contact": "Loss in contact damping",
    "joints": "Loss in joint dampers",
    "rollers": "Loss in roller dampers and bearings",
}


# --- reference ----------------------------------------------------------------------------------------------------------


def field_list(held: Any) -> list[str]:
    """Lines of reStructuredText: the fields of a record, a named tuple or a dataclass; empty for what is none of these."""
    if not inspect.isclass(held):
        return []
    if issubclass(held, BaseModel):
        rows = [(name, f.description or "") for name, f in held.model_fields.items()]
    elif dataclasses.is_dataclass(held):
        rows = [(f.name, _meant(f) or _comments(held).get(f.name, "")) for f in dataclasses.fields(held)]
    elif hasattr(held, "_fields"):
        rows = [(name, _comments(held).get(name, "")) for name in held._fields]
    else:
        return []
    return ["", *[f"- ``{name}``" + (f": {meaning}" if meaning else "") for name, meaning in rows], ""]


def _meant(field: dataclasses.Field[Any]) -> str:
    if "doc" not in field.metadata:
        return ""
    unit = field.metadata.get("unit", "1")
    return field.metadata["doc"] + ("" if unit in ("", "1", OF_THE_FIELD) else f"; {unit}")


def _comments(held: type) -> dict[str, str]:
    """The comment beside each field of a class."""
    found = re.findall(r"^    (\w+): [^#\n]*?  # (.*)$", inspect.getsource(held), re.M)
    return {name: text.replace("|", "\\|") for name, text in found}


PARTS: dict[str, Callable[[], str]] = {
    "scene_fields": scene_fields,
    "design_fields": design_fields,
    "tolerance_fields": tolerance_fields,
    "terms": terms,
    "sizes": sizes,
    "causes": causes,
    "commands": commands,
    "words": words,
    "observed": observed,
}
"""Generated text by the name in its mark."""
