"""Every benchmark, one process after another, and one file of all their figures."""

import json
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from diffeed.base.files import write_whole
from diffeed.base.folders import OutputError, plain_errors
from diffeed.bench import files
from diffeed.bench.figures import lines
from diffeed.command.session import leave_at_once, say

FIGURES = "figures.jsonl"


class Benchmark(NamedTuple):
    """Words of a command after `diffeed bench`, those that make it short, and the file of its data."""

    words: tuple[str, ...]
    quick: tuple[str, ...]
    data: str


QUICK = ("--quick",)
BENCHMARKS = {
    "front_film_feeder": Benchmark(("front", "film_feeder"), (*QUICK, "--duration", "0.2"), files.DATA),
    "front_long_path": Benchmark(("front", "long_path", "--quick"), ("--duration", "0.05"), files.DATA),
    "features": Benchmark(("features",), ("--only-equations",), "features.json"),
    "batch": Benchmark(("batch",), QUICK, "batch.json"),
    "gradient": Benchmark(("gradient",), ("--duration", "0.1"), "gradient.json"),
    "roughness": Benchmark(("roughness",), QUICK, "roughness.json"),
    "ripple": Benchmark(("ripple",), QUICK, "ripple.json"),
    "growth": Benchmark(("growth",), QUICK, "growth.json"),
    "stability": Benchmark(("stability",), QUICK, "stability.json"),
}
"""By the name of its folder."""


def run_all(out: Path, only: tuple[str, ...], quick: bool, force: bool) -> list[str]:
    """Make what is missing in `out` (all of it with `force`), then the file of figures; the names of those that failed.

    Raises OutputError where `only` names no benchmark, or the folder cannot be written.
    """
    for name in only:
        if name not in BENCHMARKS:
            raise OutputError(f"--only must be one of {', '.join(BENCHMARKS)}, but is {name}")
    failed = []
    for name in only or BENCHMARKS:
        folder, made = out / _folder(name, quick), BENCHMARKS[name]
        if (folder / made.data).exists() and not force:
            say(f"{folder}: there already")
            continue
        words = ["bench", *made.words, *(made.quick if quick else ()), "--out", str(folder), *["--force"] * force]
        say(f"diffeed {' '.join(words)}")
        if not _run(words, out):
            failed.append(name)
            say(f"{name} failed; see above")
    _write(out)
    return failed


def _folder(name: str, quick: bool) -> str:
    """Short benchmarks are other ones: they do not stand for the long ones."""
    return f"{name}_quick" if quick else name


def _run(words: list[str], out: Path) -> bool:
    with subprocess.Popen([sys.executable, "-m", "diffeed", *words]) as process:
        try:
            return process.wait() == 0
        except KeyboardInterrupt:
            process.kill()
            process.wait()
            _write(out)
            say(f"stopped by Ctrl-C; {out} keeps what was finished, and the same command goes on from there")
            leave_at_once(130)
    return False


def _write(out: Path) -> None:
    """The figures of all benchmarks that the folder holds."""
    found = []
    for name, made in BENCHMARKS.items():
        for folder in (_folder(name, False), _folder(name, True)):
            if (out / folder / made.data).exists():
                data = json.loads((out / folder / made.data).read_text("utf-8"))
                found += [f"{line}\n" for line in lines(folder, data)]
    if found:
        with plain_errors(f"{out / FIGURES} could not be written"):
            write_whole(out / FIGURES, "".join(found))
        print(f"{len(found)} figures written to {out / FIGURES}")
