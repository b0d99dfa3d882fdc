"""Real commands, killed at random moments. A folder is then complete, or plainly not, and the same command brings it to its end.

Half of the kills come at any time, half just after something in the folder changed: that is where files are half written.
"""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np

from diffeed.input.scene_file import load_scene
from tests.search.seeds import ROOT

SCENE = (ROOT / "tests/search/strip.toml").read_text("utf-8")
DESIGN = """
scene = "strip.toml"
duration = 0.01
frames = 5

[variables.preload]
path = "rollers.pinch.preload"
bounds = [1.0, 8.0]

[objective.force]
measure = "nip_force"
of = "pinch"
target = 4.0

[search]
learning_rate = 0.1
iterations = 12
"""
TOLERANCE = """
scene = "strip.toml"
duration = 0.01
frames = 5
samples = 24

[tolerances.preload]
path = "rollers.pinch.preload"
sigma = 0.1

[measures.fed]
measure = "fed"

[limits.force]
measure = "nip_force"
of = "pinch"
at_most = 5.1

[latitude.x]
path = "sheets.strip.thickness"
range = [0.1, 0.2]
points = 2

[latitude.y]
path = "rollers.pinch.preload"
range = [4.0, 6.0]
points = 2
"""


class Fault(Exception):
    """What must not be left behind, or must not be said."""


@dataclass(frozen=True)
class Command:
    """A command that writes `out`; the file that it writes last; how it is told to go on with what is there."""

    words: tuple[str, ...]
    last: str
    again: str
    first: bool = True  # False: there is a finished result, which it was asked to replace
    measures: bool = False  # what it writes are times, other ones in every run


COMMANDS = {
    "run": Command(("-m", "diffeed.cli", "run", "strip.toml", "--frames", "3"), "summary.json", "--force"),
    "run --force": Command(
        ("-m", "diffeed.cli", "run", "strip.toml", "--frames", "3", "--force"), "summary.json", "--force", False
    ),
    "design": Command(("-m", "optimize", "design", "design.toml", "--no-pictures"), "result.json", "--resume"),
    "tolerance": Command(("-m", "optimize", "tolerance", "tolerance.toml", "--chunk", "4"), "result.json", "--resume"),
    "latitude": Command(("-m", "optimize", "latitude", "tolerance.toml"), "latitude.json", "--force"),
    "check": Command(("-m", "optimize", "check", "design.toml", "--samples", "8"), "gradients.json", "--force"),
    "compare": Command(
        ("-m", "optimize", "compare", "design.toml", "--budget", "10"), "comparison.json", "--force", measures=True
    ),
    "bench": Command(
        ("-m", "diffeed.cli", "bench", "batch", "strip.toml", "--size", "1"), "batch.json", "--force", measures=True
    ),
}


class Place:
    """A folder with scene and studies, and a cache of compiled programs, killed with the rest."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.out = folder, folder / "results" / "out"
        for name, text in (("strip", SCENE), ("design", DESIGN), ("tolerance", TOLERANCE)):
            (folder / f"{name}.toml").write_text(text, "utf-8")
        self.out.parent.mkdir(exist_ok=True)
        self._references: dict[str, tuple[dict[str, Any], float, int]] = {}

    def start(self, command: Command, *more: str) -> subprocess.Popen[str]:
        environment = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "JAX_COMPILATION_CACHE_DIR")}
        environment |= {"XDG_CACHE_HOME": str(self.folder / "cache"), "PYTHONPATH": str(ROOT)}
        return subprocess.Popen(
            [sys.executable, *command.words, "--out", str(self.out), *more], cwd=self.folder, env=environment, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip

    def finish(self, command: Command, *more: str) -> tuple[int, str]:
        process = self.start(command, *more)
        text, _ = process.communicate(timeout=300)
        if "Traceback" in text:
            raise Fault(text)
        return process.returncode, text

    def empty(self) -> None:
        shutil.rmtree(self.out.parent, ignore_errors=True)
        self.out.parent.mkdir()

    def reference(self, name: str) -> tuple[dict[str, Any], float, int]:
        """What the command leaves when nobody kills it, how long it takes, how often its folder changes."""
        if name not in self._references:
            command = COMMANDS[name]
            self.empty()
            self.finish(command)  # compiles
            if command.first:
                self.empty()
            begun, process = time.monotonic(), self.start(command)
            changes = watch(self.out.parent, process, lambda _: False)
            text, _ = process.communicate(timeout=300)
            if process.returncode:
                raise Fault(text)
            self._references[name] = contents(self.out), time.monotonic() - begun, changes
        return self._references[name]


def watch(folder: Path, process: subprocess.Popen[str], enough: Callable[[int], bool]) -> int:
    """Count changes of what lies in a folder until the process ends, or until it is enough."""
    before, changes = None, 0
    while process.poll() is None and not enough(changes):
        now = []
        for place, _, names in os.walk(folder):
            for name in names:
                try:
                    now.append((place, name, os.stat(os.path.join(place, name)).st_size))
                except OSError:
                    now.append((place, name, -1))
        changes += now != before
        before = now
        time.sleep(0.0005)
    return changes


def killed_once(place: Path | Place, name: str, seed: int) -> str:
    """Kill a command at a random moment, look at its folder, let it come to its end; what the kill left. Raises Fault."""
    place = place if isinstance(place, Place) else Place(place)
    command, chance = COMMANDS[name], random.Random(f"{name} {seed}")
    reference, seconds, changes = place.reference(name)
    place.empty()
    if not command.first:
        place.finish(command)
    process = place.start(command)
    if chance.random() < 0.5:
        end = time.monotonic() + chance.uniform(0.0, 1.1 * seconds)
        watch(place.out.parent, process, lambda _: time.monotonic() > end)
    else:
        after = chance.randint(2, max(2, changes))
        watch(place.out.parent, process, lambda count: count >= after)
        time.sleep(chance.choice((0.0, 0.0, 0.001, 0.01)))
    process.send_signal(signal.SIGKILL)
    process.communicate()
    left = look(place, command)
    bring_to_end(place, command)
    drafts = [p.name for p in place.out.parent.rglob(".*")]
    if drafts:
        raise Fault(f"{name} {seed}: drafts are left at the end: {drafts}")
    end = contents(place.out)
    if command.measures:  # whole, and all there
        reference, end = (dict.fromkeys(found) for found in (reference, end))
    if difference := first_difference(reference, end):
        raise Fault(f"{name} {seed}: after {left} the end is another: {difference}")
    return left


def look(place: Place, command: Command) -> str:
    """Whether a folder is complete, partial, or not there; every file that has its final name is whole."""
    others = [p.name for p in place.out.parent.iterdir() if p != place.out and p.name != ".out.part"]
    if others:
        raise Fault(f"beside the folder lie {others}")
    if not place.out.exists():
        return "a draft" if list(place.out.parent.iterdir()) else "nothing"
    contents(place.out)
    return "all" if (place.out / command.last).exists() else "a part"


def bring_to_end(place: Place, command: Command) -> None:
    """As a user would: the same command, and what it asks to be given."""
    status, text = place.finish(command)
    if status and command.again in text:
        status, text = place.finish(command, command.again)
    if status:
        raise Fault(f"it cannot be gone on with: {text}")


def contents(folder: Path) -> dict[str, Any]:
    """Every file of a folder, read; pictures and pages as whether they are whole. Fault for one that cannot be read."""
    found = {}
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") and path.name.endswith(".part"):
            continue
        try:
            found[path.name] = _content(path)
        except Exception as error:
            raise Fault(f"{path.name} cannot be read: {type(error).__name__}: {error}") from error
    return found


def _content(path: Path) -> Any:
    match path.suffix:
        case ".json":
            return _timeless(json.loads(path.read_text("utf-8")))
        case ".jsonl":
            text = path.read_text("utf-8")
            return [_timeless(json.loads(line)) for line in text[: text.rfind("\n") + 1].splitlines()]
        case ".npz":
            with np.load(path, allow_pickle=False) as data:
                return {k: data[k].tolist() for k in data.files if k != "seconds"}
        case ".toml":
            load_scene(path)
            return path.read_text("utf-8")
        case ".html":
            return path.read_text("utf-8").rstrip().endswith("</html>") or _broken("the page is cut off")
        case ".png":
            return path.read_bytes().endswith(b"IEND\xaeB`\x82") or _broken("the picture is cut off")
    return path.read_text("utf-8")


def _broken(why: str) -> Any:
    raise ValueError(why)


def _timeless(value: Any) -> Any:
    """Without what differs from run to run: clocks and arguments."""
    if isinstance(value, dict):
        return {k: _timeless(v) for k, v in value.items() if "seconds" not in k and k != "settings"}
    return [_timeless(v) for v in value] if isinstance(value, list) else value


def first_difference(a: Any, b: Any, path: str = "") -> str:
    """Where two contents differ, or nothing."""
    if isinstance(a, dict) and isinstance(b, dict):
        if a.keys() != b.keys():
            return f"{path}: {sorted(set(a) ^ set(b))}"
        return next((d for k in a if (d := first_difference(a[k], b[k], f"{path}/{k}"))), "")
    if isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            return f"{path}: {len(a)} and {len(b)} entries"
        return next(
            (d for k, (x, y) in enumerate(zip(a, b, strict=True)) if (d := first_difference(x, y, f"{path}/{k}"))), ""
        )
    same = a == b or (isinstance(a, float) and isinstance(b, float) and np.isnan(a) and np.isnan(b))
    return "" if same else f"{path}: {str(a)[:80]} and {str(b)[:80]}"


@click.command()
@click.option("--count", default=50, show_default=True, help="Kills, spread over the commands.")
@click.option("--seed", default=0, show_default=True, help="Number of the first kill.")
@click.option("--only", type=click.Choice(list(COMMANDS)), help="This command only.")
def command(count: int, seed: int, only: str | None) -> None:
    """Kill real commands at random moments; what they leave must be complete or plainly partial, and be brought to its end."""
    names = [only] if only else list(COMMANDS)
    found: Counter[str] = Counter()
    faults = 0
    with TemporaryDirectory() as folder:
        place = Place(Path(folder))
        for k in range(count):
            name = names[k % len(names)]
            try:
                left = killed_once(place, name, seed + k)
                found[f"{name}: {left}"] += 1
                click.echo(f"{k + 1} of {count}: {name} left {left}", err=True)
            except Fault as fault:
                faults += 1
                click.echo(f"{name}, seed {seed + k}: {fault}")
    click.echo(", ".join(f"{what} {n}" for what, n in sorted(found.items())) + f"; {faults} faults")
    raise SystemExit(1 if faults else 0)
