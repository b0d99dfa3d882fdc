"""Run a page of the documentation as a reader would: its blocks in their order, in the present folder.

    python run_page.py docs/tutorial.md

Python blocks share one namespace, and so do the checks: lines of the page's source that begin with "% ", which a reader does not
see. A TOML block with a caption is written to the file of that name. Shell blocks run in bash, but for lines with `pip install`.
"""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

FENCE = re.compile(r"^```(\w+|\{[\w-]+\})[ ]?(.*)$")
OPTION = re.compile(r"^:([\w-]+): ?(.*)$")


class Block(NamedTuple):
    """A fenced block or a check. `kind`: its language; "check" for lines that begin with "% "; else "{directive}"."""

    kind: str
    argument: str
    options: dict[str, str]
    text: str
    line: int  # of its first line of text, from 1


def blocks(page: Path) -> Iterator[Block]:
    """The blocks of a page in their order."""
    lines = page.read_text("utf-8").splitlines()
    i = 0
    while i < len(lines):
        opened = FENCE.match(lines[i])
        start = i
        if opened:
            end = next(k for k in range(i + 1, len(lines)) if lines[k] == "```")
            yield _fenced(opened, lines[start + 1 : end], start + 2)
            i = end + 1
        elif lines[i].startswith("% "):
            while i < len(lines) and lines[i].startswith("% "):
                i += 1
            yield Block("check", "", {}, "\n".join(line[2:] for line in lines[start:i]) + "\n", start + 1)
        else:
            i += 1


def _fenced(opened: re.Match[str], body: list[str], line: int) -> Block:
    kind, argument, options = opened[1], opened[2], {}
    if kind.startswith("{"):
        while body and (option := OPTION.match(body[0])):
            options[option[1]] = option[2].strip('"')
            body, line = body[1:], line + 1
    if kind == "{code-block}":
        kind, argument = argument, ""
    return Block(kind, argument, options, "\n".join(body) + "\n", line)


def shell(text: str) -> str:
    """What is run of a shell block: installing is the reader's."""
    return "\n".join(line for line in text.splitlines() if "pip install" not in line)


def files(page: Path) -> dict[str, str]:
    """Name and text of the files that a page shows."""
    found = {}
    for block in blocks(page):
        if block.kind in ("toml", "{literalinclude}") and "caption" in block.options:
            shown = (
                block.text if block.kind != "{literalinclude}" else (page.parent / block.argument).read_text("utf-8")
            )
            found[block.options["caption"]] = shown
    return found


def run(page: Path) -> None:
    """Every block; the first error ends it."""
    namespace = {"__name__": "__main__"}
    for name, text in files(page).items():
        Path(name).write_text(text, "utf-8")
    for block in blocks(page):
        if block.kind in ("python", "check"):
            code = "\n" * (block.line - 1) + block.text  # so that a traceback names the page's own lines
            exec(compile(code, str(page), "exec"), namespace)
        elif block.kind == "sh" and (text := shell(block.text)):
            sys.stdout.flush()
            path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
            subprocess.run(["bash", "-euo", "pipefail", "-c", text], check=True, env=os.environ | {"PATH": path})


if __name__ == "__main__":
    run(Path(sys.argv[1]).resolve())
