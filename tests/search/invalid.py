"""Files and records harmed at random: each must be read, or be refused with plain sentences. Nothing else, and at once."""

import functools
import random
import re
import signal
import traceback
from collections import Counter
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click

import diffeed
from diffeed.input import scene_file
from diffeed.input.check_records import SceneError, check_records
from diffeed.input.parts import Scene
from diffeed.input.scene_file import load_scene
from optimize.asked import StudyError
from optimize.problem import make_problem
from optimize.study_file import is_tolerance, load_study, read_table
from optimize.tolerance.problem import load_tolerance
from tests.search.mutations import harmed_record, harmed_text
from tests.search.seeds import ALL_KINDS, scenes, studies

LONGEST = 2
"""s of computing that one file may take."""
KINDS = ("scene", "study", "record")
TOLD = 500
"""Cases after which the command says how far it is."""
_WORDS = re.compile(r"traceback|object at 0x|\bdataclass|Error\b|Errno", re.IGNORECASE)


class Fault(Exception):
    """What must not happen; the case that shows it is in the text."""


def judged(kind: str, seed: int, folder: Path) -> tuple[str, str]:
    """Make one case and look at what comes of it: what it was ("read" or "refused"), and the case itself as text.

    Raises Fault.
    """
    chance = random.Random(f"{kind} {seed}")
    if kind == "record":
        harmed = harmed_record(chance.choice(_records()), chance)
        return _judge(lambda: _check(harmed), f"record {seed}"), repr(type(harmed))
    data = harmed_text(chance.choice(scenes() if kind == "scene" else studies()), chance)
    file = folder / "case.toml"
    file.write_bytes(data)
    read = load_scene if kind == "scene" else read_study
    return _judge(lambda: read(file), f"{kind} {seed}"), data.decode("utf-8", "replace")


def judged_bytes(data: bytes) -> None:
    """What a fuzzer feeds, as a scene file. Raises Fault."""
    _judge(lambda: scene_file.scene_of(data, "bytes"), "bytes")


def read_study(file: Path) -> Any:
    """As the commands read it, but for programs to be compiled."""
    whole = diffeed.check
    diffeed.check = lambda scene, *_, **__: check_records(scene)
    try:
        table, _ = read_table(str(file))
        if is_tolerance(table):
            return load_tolerance(file)
        return make_problem(load_study(file), str(file), folder=file.parent)
    finally:
        diffeed.check = whole


@functools.cache
def _records() -> list[Scene]:
    return [diffeed.read_scene(ALL_KINDS), load_scene("film_feeder")]


def _check(record: Any) -> None:
    problems = check_records(record)
    if problems:
        raise SceneError(problems)


def _judge(read: Callable[[], Any], case: str) -> str:
    with _in_time(case):
        try:
            read()
        except (SceneError, StudyError) as error:
            if not error.problems:
                raise Fault(f"{case}: refused without a reason") from None
            for problem in error.problems:
                _plain(problem, case)
            return "refused"
        except Fault:
            raise
        except BaseException as error:
            at = traceback.extract_tb(error.__traceback__)[-1]
            raise Fault(
                f"{case}: {type(error).__name__}: {error} ({Path(at.filename).name}, line {at.lineno})"
            ) from error
    return "read"


def _plain(problem: str, case: str) -> None:
    """A sentence on one line, of words, that a terminal shows as they are."""
    if not problem.isprintable() or len(problem) > 2000 or len(problem) < 10:
        raise Fault(f"{case}: not a sentence on one line: {problem!r}")
    if _WORDS.search(re.sub(r'"[^"]*"', "", problem)):
        raise Fault(f"{case}: not a plain sentence: {problem!r}")


@contextmanager
def _in_time(case: str) -> Any:
    def late(*_: Any) -> None:
        raise Fault(f"{case}: takes more than {LONGEST} s")

    before = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, LONGEST)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


@click.command()
@click.option("--count", default=10_000, show_default=True, help="Cases: a third scenes, studies and records each.")
@click.option("--seed", default=0, show_default=True, help="Number of the first case.")
@click.option("--keep", type=click.Path(path_type=Path), help="Folder for the files that show a fault.")
def command(count: int, seed: int, keep: Path | None) -> None:
    """Harm scene files, study files and records at random; each must be read or refused with plain sentences."""
    import jax

    jax.config.update("jax_enable_x64", True)
    found: Counter[str] = Counter()
    faults: list[str] = []
    with TemporaryDirectory() as folder:
        for k in range(count):
            kind = KINDS[k % len(KINDS)]
            try:
                found[f"{kind} {judged(kind, seed + k, Path(folder))[0]}"] += 1
            except Fault as fault:
                faults.append(str(fault))
                click.echo(str(fault)[:600])
                if keep and kind != "record":
                    keep.mkdir(parents=True, exist_ok=True)
                    (keep / f"{kind}_{seed + k}.toml").write_bytes((Path(folder) / "case.toml").read_bytes())
            if (k + 1) % TOLD == 0:
                click.echo(f"{k + 1} of {count} cases, {len(faults)} faults", err=True)
    click.echo(", ".join(f"{n} {what}" for what, n in sorted(found.items())) + f"; {len(faults)} faults")
    raise SystemExit(1 if faults else 0)
