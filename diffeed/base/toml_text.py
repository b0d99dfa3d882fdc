"""TOML from a file that may hold anything: plain values, or one sentence. Never more memory than a file of its size is worth."""

import re
import tomllib
from importlib.resources.abc import Traversable
from typing import Any

from diffeed.base.words import quoted

DEEPEST = 16
"""Names joined by dots in one key or table header. The reader keeps every beginning of a key: without a limit, 400 kB of dots
fill the memory of any machine."""

_NAME = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_TOO_DEEP = re.compile(rf"(?<![\w-]){_NAME}(?:[ \t]*+\.[ \t]*+{_NAME}){{{DEEPEST}}}")


class TomlError(ValueError):
    """A file that is not readable TOML; its text is a sentence for the user."""


def read(file: Traversable, largest: int) -> dict[str, Any]:
    """The tables of a file of at most `largest` bytes; no more than that is read."""
    try:
        with file.open("rb") as stream:
            return decode(stream.read(largest + 1), largest)
    except OSError as error:
        raise TomlError(f"the file is not readable TOML: {error.strerror or error}") from None


def decode(data: bytes, largest: int) -> dict[str, Any]:
    """The tables of a TOML text."""
    if len(data) > largest:
        raise TomlError(f"the file must be <= {largest / 1e6:g} MB, but is larger")
    try:
        text = data.decode("utf-8-sig")
    except ValueError as error:
        raise TomlError(f"the file is not readable TOML: {error}") from None
    if found := _TOO_DEEP.search(text):
        line = text.count("\n", 0, found.start()) + 1
        raise TomlError(f"line {line}: the file nests tables too deeply: at most {DEEPEST} names joined by dots")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise TomlError("the file nests tables or lists too deeply") from None
    except ValueError as error:
        raise TomlError(f"the file is not readable TOML: {_in_words(str(error), text)}") from None


_TWICE = ("Cannot overwrite a value", "Cannot declare")
_AT_LINE = re.compile(r" \(at (?:line (\d+), column \d+|end of document)\)$")


def _in_words(reason: str, text: str) -> str:
    """What the reader says, with the line that it means."""
    found = _AT_LINE.search(reason)
    if not found:
        return reason
    lines = text.rstrip().split("\n")
    number = int(found[1] or len(lines))
    line = "".join(lines[number - 1 : number]).strip()
    twice = "this is given a second time" if reason.startswith(_TWICE) else reason[: found.start()]
    return f"{twice}, line {number}: {quoted(line)}" if line else f"{twice}, line {number}"
