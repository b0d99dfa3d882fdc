"""What every command of diffeed does: set up the process, load a sound scene, and end at once on Ctrl-C."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

import click

import diffeed
from diffeed import tuning
from diffeed.base.terminal import refusing

if TYPE_CHECKING:
    from diffeed.input.parts import Scene

T = TypeVar("T")

SCENE = click.argument("scene")
SET = click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="PATH=VALUE",
    help="Change a value of the scene, e.g. rollers.drive_1.radius=10.2 or guides.turn.center[1]=80. Repeatable.",
)
METHOD = click.option(
    "--method",
    help="Time stepper: linear_euler (robust; default), extrapolated_euler, midpoint or runge_kutta (explicit).",
)


def set_up(float32: bool = False, keep: bool = True, alone: bool = True, once: bool = False) -> None:
    """Settings of this process, before anything is compiled. `keep`: use compiled programs of earlier runs, and keep these.
    `alone`: what is computed are single runs, not batches. `once`: and few of them, done sooner than they would be compiled to be
    faster."""
    import jax

    jax.config.update("jax_enable_x64", not float32)
    (tuning.compile_quickly if once else tuning.compile_for_speed if alone else tuning.compile_for_many)()
    if alone:
        tuning.use_one_core()
    if not keep:
        jax.config.update("jax_enable_compilation_cache", False)
    elif problem := tuning.keep_compilations():
        say(problem)


def load_sound(
    where: str,
    assignments: tuple[str, ...],
    changes: dict[str, Any],
    dt: float | None,
    method: str | None,
    tolerance: float | None = None,
    frames: int | None = None,
    then: str = "",
) -> "Scene":
    """The scene, checked; what is unusual about it is said. `then` is said once the file is read."""
    from diffeed.base.records import replace
    from diffeed.input.check_records import SceneError, checked
    from diffeed.input.paths import PathError, assign

    with refusing(SceneError, PathError):
        scene = replace(assign(diffeed.load_scene(where), assignments), **changes)
        if then:
            say(then)
        for remark in diffeed.remarks(scene):
            say(f"note: {remark}")
        problems = patiently(lambda: diffeed.check(scene, dt, method, tolerance, frames))
        if problems:
            raise SceneError(problems, where)
        return checked(scene)


def say(text: str) -> None:
    click.echo(text, err=True)


def patiently(function: Callable[[], T]) -> T:
    """Call in a thread of its own, so that Ctrl-C is answered while a program compiles."""
    results: list[T] = []
    errors: list[BaseException] = []

    def work() -> None:
        try:
            results.append(function())
        except BaseException as error:
            errors.append(error)

    worker = threading.Thread(target=work, daemon=True)
    worker.start()
    while worker.is_alive():
        worker.join(0.5)
        if interrupted.is_set():
            raise KeyboardInterrupt
    if errors:
        raise errors[0]
    return results[0]


interrupted = threading.Event()
"""Ctrl-C was pressed and not yet answered: an exception raised inside a callback of a library may be lost there."""


@contextmanager
def stoppable() -> Iterator[None]:
    """Ctrl-C ends the command where it stands."""

    def interrupt(*_: Any) -> None:
        interrupted.set()
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    except KeyboardInterrupt:
        say("stopped by Ctrl-C; nothing was written")
        leave_at_once(130)
    finally:
        signal.signal(signal.SIGINT, before)
        interrupted.clear()


def leave_at_once(status: int) -> None:
    """Leave without waiting for a step or a compilation that still runs in its thread."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)
