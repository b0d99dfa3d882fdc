"""Runs compared with finer ones: what agrees, what does not, and that wrong runs which say that they hold are found out."""

from collections import namedtuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from click.testing import CliRunner

import diffeed
from diffeed import cli
from diffeed.base.records import replace
from diffeed.input.parts import Scene
from diffeed.readings.agreement import FINER, OF_ROLLERS, SHARE, TOLD, WIDEST
from diffeed.readings.trajectory import Failure, Trajectory
from diffeed.readings.verdict import judged
from tests.search import valid
from tests.test_cli import MINI
from tests.test_search import UNSEEN

FRAMED = ("time", "sheets", "rollers", "guides", "states")


@pytest.fixture(scope="module")
def scene() -> Scene:
    return diffeed.read_scene(MINI)


@pytest.fixture(scope="module")
def run(scene) -> Trajectory:
    return jax.device_get(diffeed.simulate(scene, dt=1e-3, frames=7))


def moved(run: Trajectory, frame: int, by: float, **changes) -> Trajectory:
    """A run whose tail is elsewhere at one frame."""
    nodes = np.array(run.sheets["strip"].nodes)
    nodes[frame, -1, 1] += by
    return replace(run, sheets={"strip": replace(run.sheets["strip"], nodes=nodes)}, **changes)


def test_runs_agree_within_what_they_tell_or_a_share_of_the_way(scene, run):
    way = diffeed.confirm(scene, run, run).way
    assert way > 5.0
    told = 0.5 * WIDEST * way / TOLD
    for error, limit in ((1e-6, SHARE * way), (told, TOLD * told), (way, WIDEST * way)):
        first = replace(run, error=np.asarray(error))
        near, far = (diffeed.confirm(scene, first, moved(first, 2, by * limit)) for by in (0.8, 1.2))
        assert near.holds
        assert not far.holds
        assert far.apart == pytest.approx(1.2 * limit)
        assert (far.sheet, far.time) == ("strip", pytest.approx(float(run.time[2])))
        assert "Confirmed" in near.sentence()
        assert far.sentence().startswith(f"Not confirmed: in a run {FINER} times as fine")


def standing(run: Trajectory, frame: int) -> Trajectory:
    """A run whose sheets stay where they are at a frame."""
    states, strip = run.states, run.sheets["strip"]
    stays = {
        name: jnp.asarray(getattr(states, name)).at[frame:].set(getattr(states, name)[frame])
        for name in ("x", "y", "heading")
    }
    stands = {name: jnp.asarray(getattr(states, name)).at[frame:].set(0.0) for name in ("vx", "vy", "rate")}
    nodes = np.array(strip.nodes)
    nodes[frame:] = nodes[frame]
    return replace(run, states=replace(states, **stays, **stands), sheets={"strip": replace(strip, nodes=nodes)})


def test_what_a_sheet_does_after_its_fate_is_decided_is_not_compared(scene, run):
    """The strip passes at 12.5 ms, between the second and the third frame, and flies on; without a goal that is no end, but were
    it to stay where no roller holds it, it would have stalled."""
    for goal, frame, made in (("exit", 2, run), ("", 3, standing(run, 3))):
        asked = replace(scene, goal=goal)
        (fate,) = judged(asked, made)[1].values()
        assert run.time[frame - 1] < fate <= run.time[frame]
        here, after = (diffeed.confirm(asked, made, moved(made, k, 100.0)) for k in (frame, frame + 1))
        assert not here.holds
        assert after.holds
        assert after.until == pytest.approx(float(run.time[frame]))
        assert after.later == pytest.approx(100.0)
        assert not after.to_the_end
        assert after.sentence().endswith("Not so what came after that: it comes up to 100 mm elsewhere.")
        assert "after that" not in diffeed.confirm(asked, made, moved(made, frame + 1, 1e-3)).sentence()
    brief = replace(run, **jax.tree.map(lambda v: v[:2], {n: getattr(run, n) for n in FRAMED}))
    assert judged(scene, brief)[1] == {"strip": np.inf}


def test_another_verdict_and_a_failed_run_are_no_confirmation(scene, run):
    other = replace(scene, goal="")
    assert diffeed.confirm(other, run, run).holds
    failure = Failure(time=run.time[4], cause=np.asarray(2), part=np.asarray(-1), parts=run.failure.parts)
    broken = replace(run, ok=np.asarray(False), failure=failure)
    found = diffeed.confirm(scene, run, broken)
    assert (found.before, found.after, found.holds, found.apart) == ("passed", "failed", False, 0.0)
    assert "the verdict is failed" in found.sentence()
    assert not diffeed.confirm(scene, broken, broken).holds


Nip = namedtuple("Nip", OF_ROLLERS)


def test_what_rollers_do_differently_is_told(scene, run):
    """By more than a fifth of their own and a twentieth of the largest; over the whole of runs that observed it."""

    def seen(**of_drive):
        def nip(**values):
            return Nip(**{**dict.fromkeys(Nip._fields, 10.0), **values})

        return {"drive": nip(**of_drive), "pinch": nip(slip_rms=np.nan)}

    def compared(first, second):
        return diffeed.confirm(scene, replace(run, observed=first), replace(run, observed=second))

    alike = compared({"nips": seen()}, {"nips": seen(slip_rms=11.0, torque_mean=10.3)})
    assert alike.unsure == ()
    found = compared({"nips": seen(slip_rms=16.6, force_peak=0.1)}, {"nips": seen(slip_rms=47.2, force_peak=0.3)})
    assert found.unsure == ("slip RMS of drive, 16.6 mm/s here and 47.2 there",)
    assert found.holds
    assert found.sentence().endswith(f"Not confirmed of rollers and guides: {found.unsure[0]}.")
    assert compared({}, {"nips": seen()}).unsure == ()


def test_what_guides_bear_differently_is_told(scene, run):
    def seen(peak):
        return {"guides": {"turn": Nip(*[0.0, 1.0, peak, 0.0]), "entry": Nip(*[0.0, 1.0, 1.0, 0.0])}}

    first, second = (replace(run, observed=seen(peak)) for peak in (3.9, 1.2))
    found = diffeed.confirm(scene, first, second)
    assert found.unsure == ("normal peak of turn, 3.9 N here and 1.2 there",)
    assert diffeed.confirm(scene, first, first).unsure == ()


def test_other_frames_are_refused(scene, run):
    other = replace(run, **{name: jax.tree.map(lambda v: v[::2], getattr(run, name)) for name in FRAMED})
    with pytest.raises(ValueError, match=r"have 7 until 0\.06 s and 4 until 0\.06 s"):
        diffeed.confirm(scene, run, other)


@pytest.mark.slow
@pytest.mark.parametrize(("machine", "method", "seed"), UNSEEN)
def test_what_no_run_sees_of_itself_is_not_confirmed(machine, method, seed):
    """The runs hold, and are wrong."""
    scene = valid.scene_of(machine, seed)
    made = diffeed.stack([scene])
    run, finer = (
        valid.sample(valid.run_batch(made, dt=valid.STEPS[method] / part, method=method), 0) for part in (1, FINER)
    )
    assert run.ok
    assert finer.ok
    assert not diffeed.confirm(scene, run, finer).holds


@pytest.mark.slow
def test_the_command_confirms_or_not(tmp_path, monkeypatch):
    file = tmp_path / "mini.toml"
    file.write_text(MINI)
    out = tmp_path / "out"
    done = CliRunner().invoke(cli.main, ["run", str(file), "--dt", "1e-3", "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert "Confirmed by a run 4 times as fine" in done.output
    assert '"confirmed": {' in (out / "summary.json").read_text()
    monkeypatch.setattr("diffeed.readings.agreement.SHARE", 0.0)
    monkeypatch.setattr("diffeed.readings.agreement.TOLD", 0.0)
    done = CliRunner().invoke(cli.main, ["run", str(file), "--dt", "1e-3"])
    assert done.exit_code == 1
    assert "Believe no more than the verdict" in " ".join(done.output.split())
    done = CliRunner().invoke(cli.main, ["run", str(file), "--dt", "1e-3", "--once"])
    assert done.exit_code == 0
    assert "onfirmed" not in done.output


def test_the_help_says_what_confirming_does():
    done = CliRunner().invoke(cli.main, ["run", "--help"])
    assert f"steps {FINER} times shorter" in " ".join(done.output.split())


def test_steps_that_would_be_too_many_are_refused_beforehand(tmp_path):
    file = tmp_path / "mini.toml"
    file.write_text(MINI)
    done = CliRunner().invoke(cli.main, ["run", str(file), "--dt", "1e-10"])
    assert done.exit_code == 2
    assert "takes shorter steps: duration / dt must be at most" in done.output
    assert "--once leaves it out" in " ".join(done.output.split())


@pytest.mark.long
def test_stopped_while_confirming_the_first_run_is_kept(tmp_path, monkeypatch):
    file, out = tmp_path / "mini.toml", tmp_path / "out"
    file.write_text(MINI)
    first = cli._simulate
    left: list[int] = []

    def simulate(ask, scene, begun, shorter=1):
        if shorter > 1:
            raise KeyboardInterrupt
        return first(ask, scene, begun)

    def leave(status: int) -> None:
        left.append(status)

    monkeypatch.setattr(cli, "_simulate", simulate)
    monkeypatch.setattr(cli, "leave_at_once", leave)
    done = CliRunner().invoke(cli.main, ["run", str(file), "--dt", "1e-3", "--out", str(out)])
    assert "not confirmed: stopped by Ctrl-C" in done.output
    assert left == [130]
    assert '"status": "passed"' in (out / "summary.json").read_text()
