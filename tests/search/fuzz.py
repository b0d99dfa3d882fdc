"""A coverage-guided fuzzer on the scene-file reader: bytes to records to the check of records.

Atheris keeps what reaches new code and mutates it further. A fault is anything but a scene or plain sentences, or more than
`LONGEST` seconds; libFuzzer writes the input that shows it into the folder.
"""

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import click

from tests.search.seeds import ROOT, scenes

MISSING = 'the fuzzer needs Atheris: pip install -e ".[fuzz]"'
TARGET = """
import sys
import atheris

import jax
with atheris.instrument_imports(include=["diffeed"]):
    from diffeed.input import check_records
    from diffeed.input import check_rules
    from diffeed.input import check_values
    from diffeed.input import scene_file
    from diffeed.base import toml_text
from tests.search.invalid import judged_bytes

jax.config.update("jax_enable_x64", True)
atheris.Setup(sys.argv, judged_bytes)
atheris.Fuzz()
"""


@click.command()
@click.option("--minutes", type=click.FloatRange(0, min_open=True), default=5.0, show_default=True)
@click.option(
    "--keep", type=click.Path(path_type=Path), help="Folder of inputs to go on from, and for what shows a fault."
)
@click.option("--memory", default=4096, show_default=True, help="MB beyond which an input counts as a fault.")
def command(minutes: float, keep: Path | None, memory: int) -> None:
    """Feed the scene-file reader with what reaches new code."""
    try:
        import atheris  # noqa: F401  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise click.ClickException(MISSING) from None
    with TemporaryDirectory() as made:
        folder = keep or Path(made)
        inputs = folder / "inputs"
        inputs.mkdir(parents=True, exist_ok=True)
        for k, text in enumerate(scenes()):
            (inputs / f"seed_{k}").write_text(text, "utf-8")
        words = folder / "words.dict"
        words.write_text(_dictionary(), "utf-8")
        limits = [f"-max_total_time={int(60 * minutes)}", "-timeout=10", f"-rss_limit_mb={memory}", "-max_len=8192"]
        given = [*limits, f"-dict={words}", f"-artifact_prefix={folder}/fault_", "-print_final_stats=1", str(inputs)]
        done = subprocess.run([sys.executable, "-c", TARGET, *given], cwd=ROOT)
        raise SystemExit(1 if done.returncode else 0)


def _dictionary() -> str:
    """Every field, section and word that a scene file may hold, for libFuzzer to put in."""
    from diffeed.base.records import fields
    from diffeed.input.parts import SECTIONS

    words = {*SECTIONS, "true", "false", "nan", "inf", "[[", "]]", "1e308", '\\"', "times", "values"}
    for kinds in SECTIONS.values():
        for word, kind in kinds.items():
            words |= {word, *(f.name for f in fields(kind))}
            words |= {str(c) for f in fields(kind) for c in f.metadata.get("choices") or ()}
    return "".join(f'"{word}"\n' for word in sorted(words))
