"""What to say when a name is not known."""

import difflib
from collections.abc import Collection, Iterable

from diffeed.base.words import LONGEST, quoted

LISTED = 24
"""Names that are listed: all fields of any record."""


def nearest(name: object, known: Iterable[str]) -> str:
    """The end of a sentence: the known name that is most like this one, or nothing."""
    like = [k for k in known if len(k) <= LONGEST]
    near = difflib.get_close_matches(name[:LONGEST], like, n=1, cutoff=0.5) if isinstance(name, str) else []
    return f"; did you mean {quoted(near[0])}?" if near else ""


def known_name(kind: str, name: object, known: Collection[str]) -> None:
    """ValueError if there is no such name."""
    if name not in known:
        raise ValueError(f"no {kind} named {quoted(str(name))}{hint(name, known)}")


def hint(name: object, known: Iterable[str]) -> str:
    """The end of a sentence: the nearest known name, or a list of what there is."""
    names = sorted(known)
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    listed = ", ".join(quoted(n) for n in names[:LISTED])
    return nearest(name, names) or (f"; known: {listed}{more}" if names else "; there is none")
