"""The commands `tolerance` and `latitude`. Heavy imports stay inside them: a help text must come at once."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from diffeed.base.folders import OutputError, holding, plain_errors, publishing, refuse_overwriting
from diffeed.base.terminal import SETTINGS, Refusal, console, once_more, refusing

SCENE = click.option("--scene", help="Another scene of the same parts (an improved one), instead of the study's.")


@click.command(context_settings=SETTINGS, short_help="How often will it fail, and which tolerance is to blame?")
@click.argument("study")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the samples, the result and the pictures.")
@click.option("--resume", is_flag=True, help="Go on with the study that stopped in --out.")
@click.option("--force", is_flag=True, help="Replace a study that is already in --out.")
@click.option("--samples", type=click.IntRange(1, 10_000_000), help="Instead of the study's.")
@click.option("--dt", type=click.FloatRange(0, min_open=True), help="Longest step in s, instead of the study's.")
@SCENE
@click.option(
    "--before",
    type=click.Path(path_type=Path),
    help="Folder of a finished study of the same draws, as many or more, to compare with.",
)
@click.option(
    "--gradients",
    type=click.IntRange(0, 4096),
    default=0,
    help="Samples at which gradients are taken, for contributions.",
)
@click.option("--indices", type=click.IntRange(2, 2**20), help="Runs per input (a power of two) for Sobol indices.")
@click.option(
    "--chunk", type=click.IntRange(1, 65536), help="Samples computed at once; chosen from the machine if not given."
)
@click.option(
    "--workers", type=click.IntRange(1, 1024), help="Use so many worker processes of a Dask cluster on this machine."
)
@click.option("--scheduler", help="Use the Dask cluster at this address, tcp://host:8786 say.")
@click.option(
    "--replay", type=click.IntRange(0), multiple=True, help="Only write the animation of a sample, by its number."
)
@click.option("--no-pictures", is_flag=True, help="Write the samples and the numbers only.")
@click.option(
    "--confirm/--once",
    default=True,
    show_default=True,
    help="Run up to 16 samples again with steps 4 times shorter (or tolerance), and say which come out the same; or do not.",
)
def tolerance(study: str, **options: Any) -> None:
    """How often will it fail with the parts as they are really made, and which tolerance is to blame?

    \b
    Examples:
      python -m optimize tolerance film_tolerances --samples 256 --out made
      python -m optimize tolerance film_tolerances --samples 1024 --out made --resume
      python -m optimize tolerance film_tolerances --out made --replay 117
    """
    if options["resume"] and options["out"] is None:
        raise Refusal("--resume needs --out, the folder of the study")
    if options["resume"] and options["force"]:
        raise Refusal("--resume goes on with what is there, --force replaces it: give one of them")
    if options["replay"] and options["out"] is None:
        raise Refusal("--replay needs --out, the folder for the animation")
    if options["workers"] and options["scheduler"]:
        raise Refusal("--workers starts a cluster here, --scheduler uses another: give one of them")
    count = options["indices"]
    if count and count & (count - 1):
        raise Refusal(f"--indices must be a power of two, but is {count}")
    problem = _problem(study, options["scene"], {k: options[k] for k in ("samples", "dt") if options[k] is not None})
    from optimize.tolerance.cluster import ClusterError
    from optimize.tolerance.folder import FolderError

    with refusing(ClusterError, FolderError, OutputError), holding(options["out"]):
        if options["replay"]:
            _replay(problem, options["out"], options["replay"], options["force"])
            return
        try:
            _run(problem, **options)
        except KeyboardInterrupt:
            kept = f"; what was run is kept in {options['out']}, --resume goes on" if options["out"] else ""
            click.echo(f"stopped by Ctrl-C{kept}", err=True)
            sys.exit(130)


@click.command(context_settings=SETTINGS, short_help="Which sheets pass: a map over two quantities.")
@click.argument("study")
@SCENE
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="Folder for latitude.png and latitude.json."
)
@click.option("--force", is_flag=True, help="Replace what --out holds.")
@click.option("--points", type=click.IntRange(2, 201), help="Along each axis, instead of the study's.")
def latitude(study: str, scene: str | None, out: Path, force: bool, points: int | None) -> None:
    """Which sheets pass: a map over two quantities of a study, its [latitude.x] and [latitude.y].

    A sheet passes as a sample of `tolerance` does: its run passes, and keeps the study's limits.

    \b
    Example:
      python -m optimize latitude film_tolerances --points 11 --out latitude
    """
    problem = _problem(study, scene, {})
    if problem.study.latitude is None:
        raise Refusal(f"{study} has no [latitude.x] and [latitude.y]: give each a path and a range")
    if points:
        asked = problem.study.latitude
        axes = {n: getattr(asked, n).model_copy(update={"points": points}) for n in ("x", "y")}
        problem = problem.changed(latitude=asked.model_copy(update=axes))
    from optimize.tolerance.latitude import latitude as run
    from optimize.tolerance.report import LATITUDE, write_latitude

    with refusing(OutputError), publishing(out, LATITUDE, force) as draft:
        found = run(problem)
        click.echo(f"{int(found.passed.sum())} of {found.passed.size} sheets pass")
        assert draft is not None
        with plain_errors(f"the results were not written to {out}"):
            write_latitude(draft, found)
    click.echo(f"written to {out}: {', '.join(LATITUDE)}")


def _problem(where: str, scene: str | None, changes: dict[str, Any]) -> Any:
    import jax

    from diffeed import tuning

    jax.config.update("jax_enable_x64", True)
    tuning.compile_for_many()
    tuning.use_all_cores()
    if problem := tuning.keep_compilations():
        click.echo(problem, err=True)
    from optimize.asked import StudyError
    from optimize.tolerance.problem import load_tolerance

    with refusing(StudyError):
        click.echo(f"{where}: checking", err=True)
        return load_tolerance(where, **changes, **({"scene": scene} if scene else {}))


def _run(
    problem: Any, out: Path | None, resume: bool, force: bool, before: Path | None, gradients: int, indices: int | None,
    chunk: int | None, workers: int | None, scheduler: str | None, no_pictures: bool, confirm: bool,
    **_: Any,
) -> None:  # fmt: skip
    from optimize.tolerance import confirmation, contributions
    from optimize.tolerance.folder import INDICES, Folder, read_rows
    from optimize.tolerance.report import print_summary, write_result
    from optimize.tolerance.study import drawn, run_study
    from optimize.tolerance.summary import fails, summarise

    was = read_rows(before, problem, drawn(problem)) if before else None
    if indices:
        with refusing(ValueError):
            contributions.refuse_groups(problem)
    with _runner(problem, chunk, workers, scheduler) as runner:
        with _bar(problem.study.samples, "samples") as show:
            rows = run_study(problem, runner, out, resume, force, show)
        found = None
        if indices:
            total = indices * (len(problem.inputs) + 2)
            folder = Folder(out, problem, INDICES) if out else None
            with _bar(total, "runs for indices") as show:
                found = contributions.indices(problem, indices, runner, folder, resume=resume, show=show)
    slopes = None
    if gradients:
        count = min(gradients, len(rows.sample))
        click.echo(f"gradients at {count} samples", err=True)
        slopes = contributions.slopes(problem, rows.deviation[:count])
    confirmed = once_more("some samples", lambda: confirmation.confirm(problem, rows)) if confirm else None
    summary = summarise(problem, rows, slopes, found, confirmed)
    print_summary(console(), summary, fails(problem, was) if was else None)
    if confirmed is not None:
        console().print(f"\n{confirmed.sentence()}")
    if out:
        with plain_errors(f"the result could not be written to {out}; --resume writes it again"):
            names = write_result(out, problem, rows, summary, not no_pictures, was)
        click.echo(f"written to {out}: samples.csv, {', '.join(names)}")


def _replay(problem: Any, out: Path, samples: tuple[int, ...], force: bool) -> None:
    from optimize.tolerance.folder import names_of
    from optimize.tolerance.replay import replay

    for sample in samples:
        if not force:
            refuse_overwriting(out, names_of(sample))
        with refusing(ValueError), plain_errors(f"sample {sample} could not be written to {out}"):
            path, verdict = replay(problem, sample, out)
        click.echo(f"sample {sample}: {verdict}\nwritten to {path}")


@contextmanager
def _runner(problem: Any, chunk: int | None, workers: int | None, scheduler: str | None) -> Iterator[Any]:
    from optimize.tolerance.study import here

    if workers is None and scheduler is None:
        yield here(problem, chunk)
        return
    from optimize.tolerance.cluster import connect, on_cluster
    from optimize.tolerance.spread import TOGETHER

    with connect(scheduler, workers) as client:
        yield on_cluster(problem, client, chunk or TOGETHER)


@contextmanager
def _bar(total: int, what: str) -> Iterator[Callable[[int, int, int], None]]:
    """Progress with samples per second and the running share that does not pass; a line now and then where there is no
    terminal."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from optimize.tolerance.statistics import proportion

    screen = console(stderr=True)
    columns = (TextColumn("{task.fields[told]}"), BarColumn(), TimeRemainingColumn())
    began, first, last = time.monotonic(), 0, 0.0
    with Progress(*columns, console=screen, disable=not screen.is_terminal) as bar:
        task = bar.add_task("", total=total, told="compiling")

        def show(done: int, failed: int, now: int) -> None:
            nonlocal began, first, last
            clock = time.monotonic()
            rate = ""
            if first:  # the first chunk compiles
                rate = f", {(done - first) / (clock - began):.3g} a second"
            else:
                began, first = clock, done
            share = proportion(failed, done)
            told = (
                f"{done} of {total} {what}{rate}; {100 * share.value:.3g} % do not pass "
                f"({100 * share.low:.3g} to {100 * share.high:.3g})"
            )
            bar.update(task, completed=done, told=told)
            if not screen.is_terminal and (clock - last > 30.0 or done == total):
                screen.print(told, soft_wrap=True)
                last = clock

        yield show
