"""Names and values as a sentence quotes them: on one line, short, and nothing that a terminal would obey."""

import re
import reprlib
from typing import Any

LONGEST = 60
"""Characters of a quoted value, and of a name."""
NAME = re.compile(r"[A-Za-z0-9_]+")


class _Short(reprlib.Repr):
    def repr_instance(self, x: Any, level: int) -> str:
        """An object that has no text of its own is named by its kind: an address says nothing."""
        text = super().repr_instance(x, level)
        return f"a {type(x).__name__}" if " at 0x" in text else text


_SHORT = _Short()
_SHORT.maxother = _SHORT.maxstring = LONGEST


def escaped(text: str) -> str:
    """The text with line ends, control characters and the like written out."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def quoted(text: str) -> str:
    """A word in quotation marks."""
    return '"' + escaped(text if len(text) <= LONGEST else text[: LONGEST - 3] + "...") + '"'


def key_text(key: object) -> str:
    """A name as part of a path: as it is, or quoted where it could be read as something else."""
    text = str(key)
    return text if len(text) <= LONGEST and re.fullmatch(r"[\w-]+", text, re.ASCII) else quoted(text)


def short(value: Any) -> str:
    """Any value, as Python would write it."""
    try:
        return " ".join(escaped(_SHORT.repr(value)).split())
    except Exception:
        kind = "an integer" if isinstance(value, int) else f"a {type(value).__name__}"
        return f"{kind} that cannot be shown"


def name_problem(name: object) -> str | None:
    """What is wrong with the name of a part, a variable, a limit: names appear in paths, pictures and file names."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        shown = quoted(name) if isinstance(name, str) else short(name)
        return f"a name must be made of letters A-Z a-z, digits and _, but is {shown}"
    if len(name) > LONGEST:
        return f"a name must have at most {LONGEST} characters, but {quoted(name)} has {len(name)}"
    return None
