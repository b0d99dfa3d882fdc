"""The command `diffeed`. Heavy imports stay inside the commands: a help text must come at once."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import diffeed
from diffeed.base.terminal import SETTINGS, Refusal, console, hand_out, refusing
from diffeed.bench.cli import advise, bench
from diffeed.command.session import (
    METHOD,
    SCENE,
    SET,
    interrupted,
    leave_at_once,
    load_sound,
    patiently,
    say,
    set_up,
    stoppable,
)

if TYPE_CHECKING:
    from diffeed.command.earlier import Earlier
    from diffeed.input.parts import Scene
    from diffeed.readings.agreement import Confirmation
    from diffeed.readings.trajectory import Trajectory


@dataclass(frozen=True)
class Request:
    """The arguments of `diffeed run`."""

    scene: str
    dt: float | None
    tolerance: float | None
    duration: float | None
    method: str | None
    frames: int
    out: Path | None
    assignments: tuple[str, ...]
    before: Path | None
    force: bool
    float32: bool
    confirm: bool


@dataclass
class Progress:
    """A run so far; `stopped` by Ctrl-C."""

    pieces: list["Trajectory"] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    stopped: bool = False


@click.group(
    context_settings=SETTINGS,
    epilog="""\b
Examples:
  diffeed scenes
  diffeed run film_feeder --out results
  diffeed COMMAND --help
""",
)
@click.version_option(diffeed.__version__, prog_name="diffeed")
def main() -> None:
    """Simulate how a sheet of paper or film runs through rollers and guides."""


@main.command(
    context_settings=SETTINGS,
    short_help="Run a scene and report how the sheet ran.",
    epilog="""\b
Examples:
  diffeed run film_feeder
  diffeed run film_feeder --out first
  diffeed run film_feeder --set rollers.drive_1.radius=10.2 --out second --before first
  diffeed run my_machine.toml --duration 0.5 --dt 5e-5 --out fine --force
  diffeed run my_machine.toml --tolerance 0.01 --once
\b
Exit status: 0 the run was computed (passed, late or jammed: see the first line),
1 the computation failed, or place and verdict were not confirmed, 2 nothing was run or the files could not be written,
130 stopped by Ctrl-C.
""",
)
@SCENE
@click.option("--dt", type=float, help="Longest time step, s; default: 1e-4, with --tolerance 2e-3.")
@click.option("--tolerance", type=float, help="Choose steps by their error, mm per step; 0.01 is a good start.")
@click.option("--duration", type=float, help="Length of the run, s; default: the scene's own.")
@METHOD
@click.option(
    "--frames", type=click.IntRange(min=2), default=101, show_default=True, help="Moments kept, evenly spaced."
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="Write pictures, an animation (player.html), data.npz, scene.toml and summary.json into FOLDER.",
)
@SET
@click.option(
    "--before",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="Results of an earlier run: tell what differs, and play both runs in one player.",
)
@click.option("--force", is_flag=True, help="Replace the results that FOLDER holds.")
@click.option("--float32", is_flag=True, help="Compute in single precision: good to about three digits.")
@click.option(
    "--confirm/--once",
    default=True,
    show_default=True,
    help="Run again with steps 4 times shorter, or such a tolerance, and say whether the runs agree; or do not.",
)
def run(**arguments: Any) -> None:
    """Run SCENE, a shipped scene's name (see `diffeed scenes`) or a TOML file, and report how the sheet ran."""
    with stoppable():
        status = _run(Request(**arguments))
    sys.exit(status)


@main.command(
    context_settings=SETTINGS,
    epilog="""\b
Examples:
  diffeed check my_machine.toml
  diffeed check film_feeder --dt 1e-5 --method runge_kutta
\b
Exit status: 0 sound, 2 something is wrong.
""",
)
@SCENE
@click.option("--dt", type=float, help="Also judge this time step, s.")
@METHOD
@SET
def check(scene: str, dt: float | None, method: str | None, assignments: tuple[str, ...]) -> None:
    """Say everything that is wrong with SCENE, or "sound"."""
    with stoppable():
        set_up(float32=False, once=True)
        load_sound(scene, assignments, {}, dt, method)
    click.echo("sound")


@main.command(
    context_settings=SETTINGS,
    short_help="List the scenes that come with diffeed, or print one.",
    epilog="""\b
Examples:
  diffeed scenes
  diffeed scenes film_feeder > my_machine.toml
""",
)
@click.argument("name", required=False)
def scenes(name: str | None) -> None:
    """List the scenes that come with diffeed, or print the file of one: a start for a machine of your own."""
    from diffeed.input.check_records import SceneError
    from diffeed.input.scene_file import shipped_text

    if name is not None:
        with refusing(SceneError):
            click.echo(shipped_text(name), nl=False)
        return
    for name, purpose in diffeed.shipped_scenes().items():
        click.echo(f"{name}\n{click.wrap_text(purpose, width=78, initial_indent='  ', subsequent_indent='  ')}")


@main.command(
    context_settings=SETTINGS,
    short_help="Print what a scene file may hold, for an editor.",
    epilog="""\b
Examples:
  diffeed schema --out diffeed.schema.json
\b
In an editor that knows TOML schemas, write at the top of a scene file:
  #:schema ./diffeed.schema.json
""",
)
@click.option("--out", type=click.Path(path_type=Path), metavar="FILE", help="Write it to FILE.")
@click.option("--force", is_flag=True, help="Replace FILE.")
def schema(out: Path | None, force: bool) -> None:
    """Print the JSON schema of scene files, by which an editor completes and checks them."""
    from diffeed.schema import scene_schema, schema_text

    hand_out(schema_text(scene_schema()), out, force)


main.add_command(bench)
main.add_command(advise)


def _run(ask: Request) -> int:
    from diffeed.base.folders import OutputError, draft_of, refuse_overwriting
    from diffeed.command.earlier import read_run
    from diffeed.command.outputs import FILES

    kept = () if ask.force else FILES
    with refusing(OutputError):
        if ask.out:
            refuse_overwriting(ask.out, kept)  # at once
        begun = time.perf_counter()
        set_up(ask.float32, once=True)  # before a scene is read, which starts the compiler
        earlier = read_run(ask.before) if ask.before else None
        changes = {} if ask.duration is None else {"duration": ask.duration}
        then = f"{ask.scene}: checking, settling at rest and compiling (takes longest the first time)"
        scene = load_sound(ask.scene, ask.assignments, changes, ask.dt, ask.method, ask.tolerance, ask.frames, then)
        if ask.confirm:
            _refuse_too_fine(ask, scene)
        with draft_of(ask.out, kept) if ask.out else nullcontext() as draft:
            progress = _simulate(ask, scene, begun)
            status = _finish(ask, scene, progress, draft, earlier)
        if progress.stopped:
            leave_at_once(130)
        return status


def _refuse_too_fine(ask: Request, scene: "Scene") -> None:
    from diffeed.base.limits import run_problem, scene_size
    from diffeed.readings.agreement import finer
    from diffeed.run.rollout import STEP

    steps = finer(ask.dt or STEP)["dt"] if ask.tolerance is None else None
    if problem := run_problem(scene.duration, steps, ask.frames, scene_size(scene)):
        raise Refusal(f"the run that confirms this one takes shorter steps: {problem}; --once leaves it out")


def _simulate(ask: Request, scene: "Scene", begun: float, shorter: int = 1) -> Progress:
    """Piece after piece, until the end, the first failure or Ctrl-C. `shorter`: see `run_in_pieces`."""
    from diffeed.command.report import OBSERVE
    from diffeed.run.pieces import run_in_pieces
    from diffeed.steppers import DEFAULT

    pieces = run_in_pieces(scene, ask.dt, ask.frames, ask.method or DEFAULT, OBSERVE, ask.tolerance, shorter)
    progress = Progress(seconds=[begun])
    try:
        with _bar(scene.duration) as show:
            while (piece := patiently(lambda: next(pieces, None))) is not None:
                progress.pieces.append(piece)
                progress.seconds.append(time.perf_counter())
                show(float(piece.time[-1]))
    except KeyboardInterrupt:
        if not progress.pieces:
            raise
        interrupted.clear()
        progress.stopped = True
    return progress


def _finish(ask: Request, scene: "Scene", progress: Progress, draft: Path | None, earlier: "Earlier | None") -> int:
    """Report and write what there is; the exit status."""
    from diffeed.command.outputs import write_files
    from diffeed.command.report import numbers, print_changes, print_report, summarise
    from diffeed.readings.trajectory import join
    from diffeed.run.pieces import cut_at_failure

    trajectory = cut_at_failure(join(progress.pieces))
    summary = summarise(scene, trajectory) | _circumstances(ask, scene, trajectory, progress)
    if progress.stopped:
        reason = "stopped by Ctrl-C before the end of the run"
        summary["verdict"] = {
            "status": "stopped", "reason": reason, "time": float(trajectory.time[-1]), "place": ""
        }  # fmt: skip
    print_report(console(), summary)
    confirmed, again = _confirm(ask, scene, trajectory, progress) if ask.confirm and trajectory.ok else (None, None)
    if confirmed:
        summary["confirmed"] = confirmed._asdict()
    if again:
        summary["finer"] = numbers(summarise(scene, again))
    if earlier:
        print_changes(console(), earlier.summary, summary)
    if not trajectory.ok:
        say(f"The run failed {trajectory.failure.describe()}.\n{_hint(ask, int(trajectory.failure.cause))}")
    if ask.out and draft:
        names = write_files(draft, ask.out, scene, trajectory, summary, earlier and (earlier.scene, earlier.run))
        click.echo(f"written to {ask.out}: {', '.join(names)}")
    return 0 if trajectory.ok and (confirmed is None or confirmed.holds) else 1


def _confirm(
    ask: Request, scene: "Scene", trajectory: "Trajectory", progress: Progress
) -> "tuple[Confirmation | None, Trajectory | None]":
    """Run again with shorter steps, say how far the two are apart, and that run if it did not fail; None where Ctrl-C came before
    that was known: the first run is not lost by it."""
    from diffeed.readings.agreement import FINER, confirm
    from diffeed.readings.trajectory import join
    from diffeed.run.pieces import cut_at_failure

    if progress.stopped:
        return None, None
    say(f"{ask.scene}: once more, with shorter steps (--once leaves that out)")
    try:
        again = _simulate(ask, scene, time.perf_counter(), FINER)
    except KeyboardInterrupt:
        interrupted.clear()
        again = Progress(stopped=True)
    if again.stopped:
        progress.stopped = True
        say("not confirmed: stopped by Ctrl-C")
        return None, None
    finer = cut_at_failure(join(again.pieces))
    found = confirm(scene, trajectory, finer)
    console().print(found.sentence())
    return found, finer if finer.ok else None


def _circumstances(ask: Request, scene: "Scene", trajectory: "Trajectory", progress: Progress) -> dict[str, Any]:
    """What was run, with what, and how long it took."""
    import platform

    import jax
    import numpy

    from diffeed.steppers import DEFAULT

    settings = {key: str(value) if isinstance(value, Path) else value for key, value in asdict(ask).items()}
    simulated, dt = float(trajectory.time[-1]), float(trajectory.dt)
    first, *rest = progress.seconds[1:]
    took = {
        "scene": ask.scene,
        "simulated": simulated,
        "duration": scene.duration,
        "dt": dt,
        "steps": int(trajectory.steps),
        "error": float(trajectory.error),
        "tolerance": ask.tolerance,
        "method": ask.method or DEFAULT,
        "precision": "float32" if ask.float32 else "float64",
        "compile_seconds": first - progress.seconds[0],
        "run_seconds": rest[-1] - first if rest else 0.0,
    }
    versions = {"diffeed": diffeed.__version__, "jax": jax.__version__, "numpy": numpy.__version__}
    return {"run": took, "settings": settings, "versions": versions | {"python": platform.python_version()}}


def _hint(ask: Request, cause: int) -> str:
    from diffeed.faults.causes import REMEDIES, SHORTER, TOO_DEEP
    from diffeed.run.rollout import STEP
    from diffeed.steppers import DEFAULT

    if REMEDIES[cause] != SHORTER and cause != TOO_DEEP:
        return f"What helps: {REMEDIES[cause]}."
    other = f", or --method {DEFAULT}" if ask.method not in (None, DEFAULT) else ""
    if ask.tolerance is not None:
        hint = f"Try a smaller tolerance (--tolerance {ask.tolerance / 10:g}){other}."
    else:
        hint = f"Try a smaller time step (--dt {(ask.dt or STEP) / 4:g}) or --tolerance 0.01{other}."
    if cause == TOO_DEEP:
        hint += " If it fails at the same place, the sheet is driven into that part: look at its place and stiffness."
    return hint


@contextmanager
def _bar(duration: float) -> Iterator[Callable[[float], None]]:
    """A progress bar on the simulated time, in a terminal only."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.fields[done]}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"))
    screen = console(stderr=True)
    with Progress(*columns, TimeRemainingColumn(), console=screen, disable=not screen.is_terminal) as bar:
        task = bar.add_task("", total=duration, done="compiling", start=False)

        def show(seconds: float) -> None:
            bar.start_task(task)
            bar.update(task, completed=seconds, done=f"{seconds:.4g} of {duration:.4g} s")

        yield show


if __name__ == "__main__":
    main()
