"""The commands `bench` and `advise`. Heavy imports stay inside them: a help text must come at once."""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from diffeed.base.terminal import SETTINGS, Refusal, console, refusing
from diffeed.command.session import SCENE, SET, load_sound, patiently, say, set_up, stoppable

if TYPE_CHECKING:
    from diffeed.bench.records import Front
    from diffeed.input.parts import Scene

OUT = click.option(
    "--out", type=click.Path(path_type=Path), metavar="FOLDER", help="Write data and a picture into FOLDER."
)
FORCE = click.option("--force", is_flag=True, help="Replace the results that FOLDER holds.")
QUICK = click.option("--quick", is_flag=True, help="Fewer settings and smaller sizes.")
DURATION = click.option(
    "--duration", type=click.FloatRange(0, min_open=True), help="Length of the run, s; default: the scene's own."
)
DT = click.option(
    "--dt",
    "steps",
    type=click.FloatRange(0, min_open=True),
    multiple=True,
    help="A time step to try, s, instead of the usual ones. Repeatable.",
)


QUIET = 30.0
"""s between two lines of progress where there is no terminal."""


class SceneGroup(click.Group):
    """`bench SCENE` is `bench front SCENE`; a scene that is named like a benchmark needs its path, or `front`."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if args and args[0] not in self.commands and args[0] not in ("-h", "--help"):
            args = ["front", *args]
        return super().parse_args(ctx, args)


@click.group(
    cls=SceneGroup,
    context_settings=SETTINGS,
    short_help="Measure what speed costs in accuracy.",
    epilog="""\b
Examples:
  diffeed bench film_feeder --out costs
  diffeed bench gradient --out costs
  diffeed bench growth --out costs
  diffeed bench all --out figures
  diffeed bench front --help
""",
)
def bench() -> None:
    """Measure what speed costs in accuracy; `bench SCENE` is `bench front SCENE`."""


@bench.command(
    context_settings=SETTINGS,
    short_help="Error against run time at several settings.",
    epilog="""\b
Examples:
  diffeed bench film_feeder --out costs
  diffeed bench front my_machine.toml --duration 0.3 --quick
  diffeed bench film_feeder --dt 2e-4 --dt 1e-4 --dt 5e-5
""",
)
@SCENE
@OUT
@DURATION
@SET
@DT
@QUICK
@click.option("--only-steps", is_flag=True, help="Leave out other numbers of bars, precisions and models.")
@FORCE
def front(scene: str, out: Path | None, force: bool, **options: Any) -> None:
    """Run SCENE at several settings and compare each with a converged run: error against run time."""
    from diffeed.bench.files import FRONT, write_front
    from diffeed.bench.report import print_front

    with stoppable(), _draft(out, FRONT, force) as draft:
        found = _sweep(scene, **options)
        print_front(console(), found)
        _publish(out, draft, lambda draft, folder: write_front(draft, folder, found))


@bench.command(context_settings=SETTINGS)
@OUT
@click.option(
    "--patience", type=click.FloatRange(1.0), default=300.0, show_default=True, help="Longest time for one size, s."
)
@QUICK
@FORCE
def growth(out: Path | None, quick: bool, patience: float, force: bool) -> None:
    """How cost grows with bars, parts, samples and length of the run."""

    def run(show: Any) -> dict[str, Any]:
        from diffeed.bench.growth import exponents, growth

        rows = growth(quick, patience, show)
        return {"rows": rows, "exponents": exponents(rows)}

    _rows("growth", out, force, run)


@bench.command(context_settings=SETTINGS, short_help="What each feature of a scene costs.")
@OUT
@click.option("--only-equations", is_flag=True, help="Count, but compile and time nothing.")
@FORCE
def features(out: Path | None, only_equations: bool, force: bool) -> None:
    """What each feature costs: a scene with all of them, and with one taken away."""

    def run(show: Any) -> dict[str, Any]:
        from diffeed.bench.features import features, free_of_charge

        rows = features(times=not only_equations, show=show)
        return {"rows": rows, "values_not_kinds": free_of_charge(rows)[1]}

    _rows("features", out, force, run)


@bench.command(
    context_settings=SETTINGS,
    short_help="How fast batches step.",
    epilog="""\b
Examples:
  diffeed bench batch
  diffeed bench batch my_machine.toml --size 256 --size 4096 --out costs
""",
)
@click.argument("scene", default="film_feeder")
@click.option("--size", "sizes", type=click.IntRange(1, 10**6), multiple=True, help="Samples in a batch. Repeatable.")
@click.option("--dt", type=click.FloatRange(0, min_open=True), default=1e-4, show_default=True, help="Time step, s.")
@OUT
@SET
@QUICK
@FORCE
def batch(
    scene: str,
    sizes: tuple[int, ...],
    dt: float,
    out: Path | None,
    assignments: tuple[str, ...],
    quick: bool,
    force: bool,
) -> None:
    """How fast batches of SCENE (film_feeder) step, in float64 and float32, on the device that JAX has."""

    def run(show: Any) -> dict[str, Any]:
        from diffeed.bench.batch import QUICK_SIZES, batch

        sound = load_sound(scene, assignments, {}, dt, None)
        rows = batch(sound, sizes or (QUICK_SIZES if quick else ()), dt=dt, show=show)
        return {"scene": scene, "rows": rows}

    _rows("batch", out, force, run, alone=False)


@bench.command(
    context_settings=SETTINGS,
    short_help="What a gradient costs beside its run.",
    epilog="""\b
Examples:
  diffeed bench gradient
  diffeed bench gradient my_machine.toml --duration 0.5 --dt 2e-4 --out costs
""",
)
@click.argument("scene", default="film_feeder")
@DURATION
@click.option("--dt", type=click.FloatRange(0, min_open=True), default=1e-4, show_default=True, help="Time step, s.")
@OUT
@SET
@FORCE
def gradient(
    scene: str, duration: float | None, dt: float, out: Path | None, assignments: tuple[str, ...], force: bool
) -> None:
    """Time, compilation and memory of a run of SCENE (film_feeder), of its derivative by one number in forward mode, and of
    its gradient by every number in reverse mode."""

    def run(show: Any) -> dict[str, Any]:
        from diffeed.bench.gradient import gradient

        changes = {} if duration is None else {"duration": duration}
        sound = load_sound(scene, assignments, changes, dt, None)
        return {"scene": scene, "rows": gradient(sound, duration, dt, show=show)}

    _rows("gradient", out, force, run)


@bench.command(
    context_settings=SETTINGS,
    short_help="How smoothly a run follows a number of its scene.",
    epilog="""\b
Examples:
  diffeed bench roughness
  diffeed bench roughness my_machine.toml --by rollers.feed.radius --span 0.02 --out costs
""",
)
@click.argument("scene", default="film_feeder")
@click.option("--by", "path", default="rollers.drive_1.radius", show_default=True, help="The number that varies.")
@click.option(
    "--span",
    type=click.FloatRange(0, min_open=True),
    default=5e-3,
    show_default=True,
    help="By how much, to either side.",
)
@OUT
@SET
@QUICK
@FORCE
def roughness(
    scene: str, path: str, span: float, out: Path | None, assignments: tuple[str, ...], quick: bool, force: bool
) -> None:
    """How smoothly the lead edge of SCENE (film_feeder) follows a number: its scatter about a parabola, with equal and with
    chosen steps, as the scene starts and with shafts that ramp up."""

    def run(show: Any) -> dict[str, Any]:
        from diffeed.bench import roughness

        sound = load_sound(scene, assignments, {}, None, None)
        _refuse_path(sound, path, span)
        samples = roughness.QUICK_SAMPLES if quick else roughness.SAMPLES
        rows = roughness.roughness(sound, path, span, roughness.ways(quick), samples, show)
        return {"scene": scene, "by": path, "span": span, "rows": rows}

    _rows("roughness", out, force, run)


@bench.command(context_settings=SETTINGS, short_help="What bars cost in smoothness, beside the smooth skin.")
@OUT
@QUICK
@FORCE
def ripple(out: Path | None, quick: bool, force: bool) -> None:
    """Ripple of force and slip of a sheet that is pulled around a roller: on bars and on the smooth skin, by number of bars."""

    def run(show: Any) -> dict[str, Any]:
        from diffeed.bench.ripple import BARS, ripple

        return {"rows": ripple(BARS[:2] if quick else BARS, show)}

    _rows("ripple", out, force, run)


@bench.command(context_settings=SETTINGS, short_help="Where each stepper is right, inaccurate or wrong.")
@OUT
@QUICK
@FORCE
def stability(out: Path | None, quick: bool, force: bool) -> None:
    """Where each stepper is right, inaccurate, fails, or is wrong and yet holds: time step against six numbers."""

    def run(show: Any) -> dict[str, Any]:
        from diffeed.bench.stability import stability

        return {"rows": stability(quick, show)}

    _rows("stability", out, force, run, keep=True)  # nothing is timed


@bench.command(
    "all",
    context_settings=SETTINGS,
    short_help="Every benchmark, and one file of all figures.",
    epilog="""\b
Examples:
  diffeed bench all --out figures
  diffeed bench all --out figures --only growth --only batch
""",
)
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="FOLDER", required=True, help="A folder for each benchmark."
)
@click.option("--only", multiple=True, help="Of these benchmarks alone. Repeatable.")
@QUICK
@FORCE
def every(out: Path, only: tuple[str, ...], quick: bool, force: bool) -> None:
    """Every benchmark of the shipped scenes, one process after another (an hour or so), each into a folder of its own, and
    all figures as figures.jsonl: one line each, with machine, versions and commit.

    A benchmark that FOLDER holds already is not made again: a run that was stopped goes on. One that fails is told, the others
    go on, and the exit status is 1."""
    from diffeed.base.folders import OutputError, holding
    from diffeed.bench.together import run_all

    with stoppable(), refusing(OutputError), holding(out):  # alone: two that measure at a time spoil each other's times
        failed = run_all(out, only, quick, force)
    raise SystemExit(1 if failed else 0)


def _refuse_path(scene: "Scene", path: str, span: float) -> None:
    """Where the number may not go to either end of its span."""
    import diffeed
    from diffeed.input.paths import PathError, get, put

    with refusing(PathError):
        middle = get(scene, path)
    if getattr(middle, "shape", None) != ():
        raise Refusal(f"--by must name one number of the scene, but {path} is not one")
    for value in (middle - span, middle + span):
        if problems := diffeed.check(put(scene, path, value)):
            raise Refusal(f"--span {span:g} is too much: at {path} = {float(value):g}, {problems[0]}")


def _rows(
    name: str,
    out: Path | None,
    force: bool,
    run: Callable[[Any], dict[str, Any]],
    keep: bool = False,
    alone: bool = True,
) -> None:
    """A benchmark other than the front, from refusing what could not be written to its files. `keep`, `alone`: see `set_up`."""
    from diffeed.bench.files import names_of, write_rows

    with stoppable(), _draft(out, names_of(name), force) as draft:
        found, machine = _measured(run, keep, alone)
        from diffeed.bench.kinds import KINDS

        data = {**found, "machine": machine}
        KINDS[name].print(console(), data)
        _publish(
            out, draft, lambda draft, folder: write_rows(draft, folder, name, data, lambda: KINDS[name].draw(data))
        )


def _measured(run: Callable[[Any], dict[str, Any]], keep: bool, alone: bool) -> tuple[dict[str, Any], dict[str, Any]]:
    """What was found, and the machine that it was measured on, which is told at once."""
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")  # a GPU's memory is for the processes that measure
    set_up(keep=keep, alone=alone)
    from diffeed.bench.machine import machine, sentence

    found = machine()
    say(sentence(found))
    with _bar() as show:
        return patiently(lambda: run(show)), found


@click.command(
    context_settings=SETTINGS,
    short_help="Name the cheapest settings that meet an accuracy.",
    epilog="""\b
Examples:
  diffeed advise film_feeder --error 0.2
  diffeed advise film_feeder --error 0.2 --slip-error 0.5 --from costs
\b
Exit status: 0 a setting meets what is wanted, 1 none does, 2 nothing can be said.
""",
)
@SCENE
@click.option(
    "--error", type=click.FloatRange(0, min_open=True), required=True, help="Wanted: lead edge within so many mm."
)
@click.option("--slip-error", type=click.FloatRange(0, min_open=True), help="And RMS slip within so many mm/s.")
@click.option("--force-error", type=click.FloatRange(0, min_open=True), help="And nip forces within so many N.")
@click.option(
    "--from", "source", type=click.Path(path_type=Path), metavar="FOLDER",
    help="Use the benchmark of this scene in FOLDER instead of running a small one.",
)  # fmt: skip
@DURATION
@SET
@DT
@QUICK
def advise(
    scene: str, error: float, slip_error: float | None, force_error: float | None, source: Path | None, **options: Any
) -> None:
    """Name the cheapest settings that run SCENE as accurately as wanted, and say how sure that is."""
    from diffeed.bench.records import BenchError

    wanted = {"lead": error, "slip": slip_error, "force": force_error}
    wanted = {name: limit for name, limit in wanted.items() if limit is not None}
    with stoppable(), refusing(BenchError):
        found = _load(scene, source, **options) if source else _sweep(scene, **options, only_steps=True)
        met = _tell(found, wanted)
    raise SystemExit(0 if met else 1)


def _tell(found: "Front", wanted: dict[str, float]) -> bool:
    from diffeed.bench.advise import advise as choose
    from diffeed.bench.advise import call, cheaper_models, command
    from diffeed.bench.machine import sentence
    from diffeed.bench.report import digits

    advice = choose(found, wanted)
    row = advice.row
    if advice.met:
        click.echo(f"Use {row.setting.short}.")
    else:
        click.echo(f"Nothing in the sweep is as accurate as wanted. The best there is: {row.setting.short}.")
    per_step = "" if row.microseconds() is None else f", {digits(row.microseconds())} us per step"
    click.echo(f"It costs {digits(row.cost(found.duration))} s per simulated second{per_step}, and "
               f"{digits(row.compile_seconds)} s to compile.")  # fmt: skip
    for reason in advice.reasons:
        click.echo(f"  {reason}")
    if advice.met:
        click.echo(
            "Sure: margins are wide and neighbours agree." if advice.sure else "Not sure: see the reasons above."
        )
    for other in cheaper_models(found, row, wanted) if advice.met else []:
        click.echo(f"Cheaper, but another model or precision: {other}")
    click.echo(f"\n  {command(found, row)}\n  {call(found, row)}\n")
    click.echo(f"Timed on {sentence(found.machine)}")
    return advice.met


def _load(
    scene: str,
    source: Path,
    duration: float | None,
    assignments: tuple[str, ...],
    steps: tuple[float, ...],
    quick: bool,
) -> "Front":
    from diffeed.bench.files import load_front
    from diffeed.bench.front import scene_key
    from diffeed.bench.records import BenchError

    if steps or quick:
        raise Refusal("--dt and --quick are for a new sweep: leave them out, or leave out --from")
    found = load_front(source)
    set_up(keep=False)
    sound = load_sound(scene, assignments, {} if duration is None else {"duration": duration}, None, None)
    if scene_key(sound) != found.key:
        raise BenchError(
            f"{source} holds a benchmark of another scene, or of other values or another duration of this one "
            f"({found.scene}, {found.duration:g} s); give the same --set and --duration, or leave out --from"
        )
    return found


def _sweep(
    scene: str,
    duration: float | None,
    assignments: tuple[str, ...],
    steps: tuple[float, ...],
    quick: bool,
    only_steps: bool,
) -> "Front":
    set_up(keep=False)
    say(f"{scene}: checking")
    changes = {} if duration is None else {"duration": duration}
    sound = load_sound(scene, assignments, changes, None, None)
    return patiently(lambda: _front(sound, scene, assignments, steps, quick, only_steps))


def _front(
    sound: "Scene", name: str, assignments: tuple[str, ...], steps: tuple[float, ...], quick: bool, only_steps: bool
) -> "Front":
    from diffeed.bench import settings
    from diffeed.bench.front import front as run

    chosen = steps or (settings.QUICK_STEPS if quick else settings.STEPS)
    others = [] if only_steps else settings.knobs(sound, chosen)
    with _bar() as show:
        return run(
            sound, name, steps=chosen, settings=[*settings.sweep(chosen), *others], assignments=assignments, show=show
        )


@contextmanager
def _draft(out: Path | None, files: tuple[str, ...], force: bool) -> Iterator[Path | None]:
    """Refuse early what could not be written; an unwritten folder leaves nothing."""
    from diffeed.base.folders import OutputError, draft_of

    with refusing(OutputError), draft_of(out, () if force else files) if out else nullcontext() as draft:
        yield draft


def _publish(out: Path | None, draft: Path | None, write: Callable[[Path, Path], list[str]]) -> None:
    if out and draft:
        click.echo(f"written to {out}: {', '.join(write(draft, out))}")


@contextmanager
def _bar() -> Iterator[Callable[[int, int, str], None]]:
    """Progress over the settings; a line now and then where there is no terminal."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    screen = console(stderr=True)
    columns = (TextColumn("{task.completed:.0f} of {task.total:.0f}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, TextColumn("{task.fields[now]}"), console=screen, disable=not screen.is_terminal) as bar:
        task = bar.add_task("", total=1, now="")

        told = time.monotonic()

        def show(done: int, total: int, text: str) -> None:
            nonlocal told
            bar.update(task, completed=done, total=total, now=text)
            if not screen.is_terminal and time.monotonic() - told > QUIET:
                say(f"{done} of {total}: {text}")
                told = time.monotonic()

        yield show
