"""The command `python -m optimize`. Heavy imports stay inside the commands: a help text must come at once."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from diffeed.base.folders import OutputError, holding, plain_errors, publishing
from diffeed.base.terminal import SETTINGS, Refusal, console, hand_out, once_more, refusing
from optimize.tolerance.cli import latitude, tolerance

if TYPE_CHECKING:
    from optimize.confirmation import Confirmation
    from optimize.design_run import Result

STUDY = click.argument("study")
FUSE = click.option(
    "--fuse",
    is_flag=True,
    help="With JAX 0.10, several results by one loop, as 0.12 does unasked: no faster where measured, and takes memory.",
)
FORCE = click.option("--force", is_flag=True, help="Replace what --out holds.")


@click.group(context_settings=SETTINGS)
def main() -> None:
    """Improve a machine by the gradient of its simulation.

    A STUDY is the name of a shipped study or a TOML file: a scene, what may change, what is wanted, what must hold.
    """


main.add_command(tolerance)
main.add_command(latitude)


@main.command(context_settings=SETTINGS)
@STUDY
@FUSE
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the improved scene, pictures and the search.")
@click.option("--resume", is_flag=True, help="Go on with the search that stopped in --out.")
@click.option("--force", is_flag=True, help="Replace a search that is already in --out.")
@click.option("--iterations", type=click.IntRange(1), help="Instead of the study's.")
@click.option("--seconds", type=click.FloatRange(0, min_open=True), help="Stop after this time.")
@click.option("--no-pictures", is_flag=True, help="Write the scene and the numbers only.")
@click.option(
    "--confirm/--once",
    default=True,
    show_default=True,
    help="Run the result again with steps 4 times shorter, or such a tolerance, and say whether it is better there; or do not.",
)
def design(
    study: str,
    fuse: bool,
    out: Path | None,
    resume: bool,
    force: bool,
    iterations: int | None,
    seconds: float | None,
    no_pictures: bool,
    confirm: bool,
) -> None:
    """Search for a better machine.

    \b
    Examples:
      python -m optimize design nip_slip --out better
      python -m optimize design nip_slip --out better --resume --iterations 100
      python -m optimize design my_study.toml --seconds 60 --out better
    """
    if resume and out is None:
        raise Refusal("--resume needs --out, the folder of the search")
    if resume and force:
        raise Refusal("--resume goes on with what is there, --force replaces it: give one of them")
    problem = _problem(study, fuse, _changes(iterations, seconds))
    from optimize.design_run import design as run
    from optimize.journal import JournalError
    from optimize.report import print_result, write_result

    with refusing(JournalError, OutputError), holding(out):
        with _bar(problem) as show:
            result = run(problem, out, resume, force, show)
        print_result(console(), result)
        confirmed = _confirmed(result) if confirm and result.improved else None
        if out:
            if not no_pictures:
                more = (
                    "a gradient by every place, which may take longer than the search (--no-pictures leaves them out)"
                )
                click.echo(f"pictures and blame maps: {more}", err=True)
            with plain_errors(f"the result could not be written to {out}; --resume writes it again"):
                names = write_result(out, result, not no_pictures, confirmed)
            click.echo(f"written to {out}: {', '.join(names)}, history.jsonl")


def _confirmed(result: "Result") -> "Confirmation | None":
    """Say whether the result is better in shorter steps too; None where that cannot be said."""
    from optimize.confirmation import confirm

    found = once_more("before and after", lambda: confirm(result))
    if found is not None:
        console().print(found.sentence())
    return found


@main.command(context_settings=SETTINGS, short_help="May the gradients of a study be believed?")
@STUDY
@FUSE
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the table, as text and as numbers.")
@FORCE
@click.option("--samples", type=click.IntRange(8, 4096), default=64, show_default=True, help="Runs for each trend.")
def check(study: str, fuse: bool, out: Path | None, force: bool, samples: int) -> None:
    """May the gradients of a study be believed? Both modes, differences, and the trend over a designer's step.

    \b
    Example:
      python -m optimize check nip_slip
    """
    problem = _problem(study, fuse, {}, many=True)
    from optimize.trust import FILES, check_study, write_check

    with refusing(OutputError), publishing(out, FILES, force) as draft:
        found = check_study(problem, samples)
        click.echo(str(found))
        if draft:
            with plain_errors(f"the results were not written to {out}"):
                write_check(draft, found)
    if out:
        click.echo(f"written to {out}: {', '.join(FILES)}")


@main.command(context_settings=SETTINGS, short_help="The gradient beside searches without one.")
@STUDY
@FUSE
@click.option("--out", type=click.Path(path_type=Path), help="Folder for comparison.json and comparison.png.")
@FORCE
@click.option(
    "--budget", type=click.IntRange(10), default=1500, show_default=True, help="Most simulations of each search."
)
def compare(study: str, fuse: bool, out: Path | None, force: bool, budget: int) -> None:
    """Simulations that the gradient needs, beside differential evolution and Nelder-Mead on the same objective.

    \b
    Example:
      python -m optimize compare nip_slip --budget 500
    """
    problem = _problem(study, fuse, {}, many=True)
    from optimize.compare import FILES, table, write_comparison
    from optimize.compare import compare as run

    with refusing(OutputError), publishing(out, FILES, force) as draft:
        found = run(problem, budget, lambda text: click.echo(text, err=True))
        click.echo(table(found))
        if draft:
            with plain_errors(f"the results were not written to {out}"):
                write_comparison(draft, found)
    if out:
        click.echo(f"written to {out}: {', '.join(FILES)}")


@main.command(context_settings=SETTINGS, short_help="List the studies that come with the package, or copy one.")
@click.argument("name", required=False)
@click.option("--out", type=click.Path(path_type=Path), help="Folder to copy study NAME into, with its scene.")
@FORCE
def studies(name: str | None, out: Path | None, force: bool) -> None:
    """List the studies that come with the package, or copy one: a start for a study of your own.

    \b
    Examples:
      python -m optimize studies
      python -m optimize studies nip_slip --out mine
    """
    from optimize.asked import StudyError
    from optimize.study_file import is_tolerance, read_table, shipped_files, shipped_studies

    if name is not None:
        with refusing(StudyError, OutputError):
            _copy(shipped_files(name), out, force)
        return
    for name in sorted(shipped_studies()):
        table, _ = read_table(name)
        kind = "tolerance" if is_tolerance(table) else "design"
        click.echo(f"{name} ({kind})\n  {table.get('title', '')}")


def _copy(files: dict[str, Path], out: Path | None, force: bool) -> None:
    """Into a folder, or the last of them to the screen."""
    with publishing(out, tuple(files), force) as draft:
        if draft is None:
            click.echo(list(files.values())[-1].read_text("utf-8"), nl=False)
            return
        with plain_errors(f"the study was not written to {out}"):
            for name, file in files.items():
                (draft / name).parent.mkdir(exist_ok=True)
                shutil.copyfile(file, draft / name)
    click.echo(f"written to {out}: {', '.join(files)}")


@main.command(context_settings=SETTINGS)
def media() -> None:
    """List the media cards, with the source of each number."""
    from optimize.tolerance.media import table

    click.echo(table())


@main.command(context_settings=SETTINGS, short_help="Print what a study file may hold, for an editor.")
@click.argument("kind", type=click.Choice(["design", "tolerance"]))
@click.option("--out", type=click.Path(path_type=Path), metavar="FILE", help="Write it to FILE.")
@click.option("--force", is_flag=True, help="Replace FILE.")
def schema(kind: str, out: Path | None, force: bool) -> None:
    """Print the JSON schema of study files of a KIND, by which an editor completes and checks them.

    \b
    Example:
      python -m optimize schema design --out study.schema.json
    In an editor that knows TOML schemas, write at the top of a study:
      #:schema ./study.schema.json
    """
    from diffeed.schema import schema_text
    from optimize.schema import study_schema

    hand_out(schema_text(study_schema(kind)), out, force)


def _changes(iterations: int | None, seconds: float | None) -> dict[str, Any]:
    given = {"iterations": iterations, "seconds": seconds}
    return {k: v for k, v in given.items() if v is not None}


def _problem(where: str, fuse: bool, changes: dict[str, Any], many: bool = False) -> Any:
    """The problem of a study. `many`: hundreds of runs and gradients are to come, for which compiling may take longer; a search
    is over after a few dozen."""
    import jax

    from diffeed import tuning

    jax.config.update("jax_enable_x64", True)
    (tuning.fuse_outputs if fuse else tuning.compile_for_speed if many else tuning.compile_quickly)()
    tuning.use_one_core()
    if problem := tuning.keep_compilations():
        click.echo(problem, err=True)
    from optimize.asked import StudyError
    from optimize.problem import make_problem
    from optimize.study_file import load_study

    with refusing(StudyError):
        study = load_study(where)
        if changes:
            found = study.search.model_copy(update=changes)
            if "iterations" in changes and found.stages:
                last = found.stages[-1].model_copy(update={"iterations": changes["iterations"]})
                found = found.model_copy(update={"stages": [*found.stages[:-1], last]})
            study = study.model_copy(update={"search": found})
        click.echo(f"{where}: checking and compiling (takes longest the first time)", err=True)
        problem = make_problem(study, where)
        click.echo(f"gradient: {problem.plan().sentence()}", err=True)
        return problem


@contextmanager
def _bar(problem: Any) -> Iterator[Callable[..., None]]:
    """A progress bar with the objective, in a terminal only."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from optimize.descent import stages_of
    from optimize.problem import SLACK

    screen = console(stderr=True)
    columns = (TextColumn("{task.fields[done]}"), BarColumn(), TimeRemainingColumn())
    total = sum(s.iterations for s in stages_of(problem))
    with Progress(*columns, console=screen, disable=not screen.is_terminal) as bar:
        task = bar.add_task("", total=total, done="compiling")

        def show(problem: Any, progress: Any, line: Any) -> None:
            kept = "" if line.violation <= SLACK else f", limits missed by {line.violation:.2g}"
            bar.update(
                task,
                completed=line.iteration,
                done=f"{line.iteration} of {total}: objective {line.objective:.5g}{kept}",
            )

        yield show
