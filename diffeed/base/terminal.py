"""What the commands share: settings of their help, refusals without traceback, console and tables."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

T = TypeVar("T")
SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}


class Refusal(click.ClickException):
    """Nothing was run or written: the reason, and status 2."""

    exit_code = 2

    def show(self, file: Any = None) -> None:
        click.echo(self.message, err=True)


@contextmanager
def refusing(*kinds: type[Exception]) -> Iterator[None]:
    """These errors are the user's to mend: their text, no traceback."""
    try:
        yield
    except kinds as error:
        raise Refusal(str(error)) from error


def once_more(what: str, find: Callable[[], T]) -> T | None:
    """What is found by running something again in shorter steps; None, and why, where that cannot be or Ctrl-C leaves it out."""
    click.echo(f"{what} once more, with shorter steps (--once leaves that out)", err=True)
    try:
        return find()
    except KeyboardInterrupt:
        click.echo("not confirmed: stopped by Ctrl-C", err=True)
    except ValueError as problem:
        click.echo(f"not confirmed: {problem}", err=True)
    return None


def hand_out(text: str, file: Path | None, force: bool) -> None:
    """Print a text, or write it to a file, which is replaced only with `force`."""
    from diffeed.base.files import write_whole
    from diffeed.base.folders import OutputError, plain_errors

    if file is None:
        click.echo(text, nl=False)
        return
    with refusing(OutputError), plain_errors(f"{file} was not written"):
        if os.path.lexists(file) and not force:
            raise OutputError(f"{file} is there already; add --force to replace it")
        write_whole(file, text)
    click.echo(f"written to {file}")


def console(stderr: bool = False) -> "Console":
    """Plain text: nothing in a message is markup."""
    from rich.console import Console

    return Console(stderr=stderr, highlight=False, markup=False, emoji=False)


def plain_table(first: str, *columns: str, words: tuple[str, ...] = ()) -> "Table":
    """A table whose first column wraps; the columns named in `words` stand left, numbers right."""
    from rich import box
    from rich.table import Table

    made = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, show_edge=False)
    made.add_column(first, overflow="fold", vertical="bottom")
    for name in columns:
        made.add_column(name, justify="left" if name in words else "right", no_wrap=True, vertical="bottom")
    return made
