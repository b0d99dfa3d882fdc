"""Random harm to a file's text or to the objects of a record. Every change follows from the generator it is given."""

import datetime
import random
import re
from collections.abc import Callable
from typing import Any

import numpy as np

VALUES = (
    "nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "-1", "0", "-0.0", "1", "2", "9" * 30, "-" + "9" * 400, "9" * 4500,
    "0x" + "f" * 5000, '""', '"x"', '"../../../x"', '"a/b"', "'<script>alert(1)</script>'", r'"\u0000"', r'"\u001b[31m\nx"',
    r'"\u202eabc"', '"$x^$"', '"' + "x" * 3000 + '"', "true", "false", "2024-01-01", "1979-05-27T07:32:00Z", "07:32:00", "[]",
    "{}", "[[]]", "[[1.0, 2.0]]", "[[[1.0]]]", "[1.0]", "[1.0, 2.0]", "[1.0, 2.0, 3.0]", '["a"]', '[1, "a"]', "[nan, 1.0]",
    "{x = 1}", '{times = [0.0], values = [1.0]}', "{times = [1.0, 0.0], values = [1.0]}", "{times = 1}", '"none"', '"lead"',
    '"rollers"', '"rollers.drive_1"', '"rollers.drive_1.radius"', '"gravity[0]"', '"sheets.film.bars"', '"/dev/zero"', '"."',
    '"scene.toml"', "1000000000", "1_000_000", "4294967296", "18446744073709551616",
)  # fmt: skip
"""Values of a file, most of them wrong wherever they stand."""
KEYS = (
    "x", "kind", '""', '"a b"', r'"\n"', '"<b>"', "a.b", "'../../up'", "radius", "__class__", "__init__", "constructor", "bars",
    "motion", "times", "con", "n" * 200, '"é"', "1", "path", "name", "a" + ".a" * 40,
)  # fmt: skip
LINES = (
    "[x]", "[[x]]", "[rollers]", "[[rollers]]", "[rollers.x]", "[sheets.x]", "[contacts.default]", "[search]",
    "[[search.stages]]", "[limits.x]", "[tolerances.x]", "[media.x]", "[latitude.x]",
    "[robust]", "[variables.'../x']", "x = 1", "= 1", "x =", "[",
    '"', "'''",
    "\x00", "\x1b[2J", "a = " + "[" * 2000, "{", "#", "]", "\\", "\ufeff", "a" + ".a" * 100 + " = 1",
)  # fmt: skip
OBJECTS: tuple[Callable[[], Any], ...] = (
    lambda: None, lambda: True, lambda: -1, lambda: 0, lambda: 10**400, lambda: 10**5000, lambda: float("nan"),
    lambda: float("inf"), lambda: 1e308, lambda: 1j, lambda: "", lambda: "x\n\x1b[2J", lambda: "x" * 5000, lambda: b"x",
    lambda: object(),
    lambda: object,
    lambda: [object()], lambda: [], lambda: [[]], lambda: [[1.0], 2.0], lambda: (1.0, None), lambda: {}, lambda: {"a": 1},
    lambda: {1: 2}, lambda: {"a\nb": {}}, lambda: datetime.date(2024, 1, 1), lambda: np.array("x"), lambda: np.zeros((0, 2)),
    lambda: np.array([1, None]), lambda: np.float32(2.0), lambda: np.array(3), lambda: np.zeros((2, 2, 2)), lambda: {1, 2},
    lambda: range(3), lambda: (i for i in range(3)), lambda: len, lambda: lambda: None, lambda: np.ma.masked,
    lambda: [float("nan")] * 3,
)  # fmt: skip


def harmed_text(text: str, chance: random.Random) -> bytes:
    """The text after one to four changes."""
    for _ in range(chance.choice((1, 1, 2, 4))):
        text = chance.choice(_CHANGES)(text, chance)
    return _bytes(text, chance)


def _bytes(text: str, chance: random.Random) -> bytes:
    """Now and then bytes are flipped, cut off or put in, so that the text may not even be text."""
    data = bytearray(text.encode("utf-8", "surrogatepass"))
    if chance.random() < 0.15 and data:
        for _ in range(chance.randint(1, 5)):
            data[chance.randrange(len(data))] = chance.randrange(256)
    if chance.random() < 0.03:
        del data[chance.randrange(len(data) + 1) :]
    return bytes(data)


def _lines(text: str, chance: random.Random) -> str:
    """A line goes, comes twice, changes places, or is put in."""
    lines = text.split("\n")
    here, there = chance.randrange(len(lines)), chance.randrange(len(lines))
    match chance.randrange(4):
        case 0:
            del lines[here]
        case 1:
            lines.insert(there, lines[here])
        case 2:
            lines[here], lines[there] = lines[there], lines[here]
        case _:
            lines.insert(here, chance.choice(LINES))
    return "\n".join(lines)


def _value(text: str, chance: random.Random) -> str:
    """A value becomes another one."""
    places = list(re.finditer(r"(?m)^([^#\n=\[]+=)([^#\n]*)", text))
    if not places:
        return text
    at = chance.choice(places)
    return text[: at.start(2)] + " " + chance.choice(VALUES) + text[at.end(2) :]


def _number(text: str, chance: random.Random) -> str:
    """A number somewhere, in a list say, becomes something else."""
    places = list(re.finditer(r"-?\d+\.?\d*(?:e-?\d+)?", text))
    if not places:
        return text
    at = chance.choice(places)
    return text[: at.start()] + chance.choice(VALUES) + text[at.end() :]


def _name(text: str, chance: random.Random) -> str:
    """A word becomes another: a key, a kind, a name in a header or in a reference."""
    places = list(re.finditer(r"[A-Za-z_]\w*", text))
    if not places:
        return text
    at = chance.choice(places)
    return text[: at.start()] + chance.choice(KEYS) + text[at.end() :]


def _key(text: str, chance: random.Random) -> str:
    """A line of its own at the end of a table."""
    lines = text.split("\n")
    lines.insert(chance.randrange(len(lines)), f"{chance.choice(KEYS)} = {chance.choice(VALUES)}")
    return "\n".join(lines)


_CHANGES = (_lines, _value, _value, _number, _name, _key)


def harmed_record(record: Any, chance: random.Random) -> Any:
    """The record (dataclasses and dicts in each other) with up to three objects put into it."""
    for _ in range(chance.randint(1, 3)):
        record = _with(record, chance)
    return record


def _with(node: Any, chance: random.Random) -> Any:
    names = list(node) if isinstance(node, dict) else list(getattr(node, "__dataclass_fields__", ()))
    if not names or chance.random() < 0.1:
        return chance.choice(OBJECTS)()
    name = chance.choice(names)
    if isinstance(node, dict):
        bad = chance.choice(("x\ny", 3, None, "n" * 200, "<b>"))
        return {**node, (bad if chance.random() < 0.05 else name): _with(node[name], chance)}
    new = object.__new__(type(node))  # as pickle would: no rule of the record is asked
    vars(new).update(vars(node) | {name: _with(getattr(node, name), chance)})
    return new
