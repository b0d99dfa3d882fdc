"""Measures against values known by construction."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffeed
from diffeed import Clamp, FixedRoller, LineGuide, MovableRoller, Profile, Scene, Sensor, Sheet, measures
from diffeed.base.records import replace

FILM = {"thickness": 0.2, "width": 20.0, "density": 1e-6, "youngs_modulus": 3000.0, "structural_damping": 1e-4}
ALL = tuple(diffeed.OBSERVERS)


def nip(speed: float = 100.0, **changes) -> Scene:
    """A sheet in one driven nip on a table, a gate 5 mm ahead of its lead and one that its tail passes."""
    # A shaft that jumps to speed would be an impact, which a coarse step blurs: it ramps up within 20 ms.
    ramp = Profile(times=(0.0, 0.02), values=(0.0, -speed / 10.0))
    parts = {
        "sheets": {"a": Sheet(length=40.0, bars=4, lead=(20.0, 0.0), **FILM)},
        "rollers": {
            "drive": FixedRoller(center=(0.0, -10.1), radius=10.0, friction=0.8, angular_speed=ramp),
            "pinch": MovableRoller(
                center=(0.0, 10.1), direction=(0.0, 1.0), radius=10.0, mass=0.02, preload=3.0, damper=0.02, friction=0.8
            ),
        },
        "guides": {
            "table": LineGuide(start=(-60.0, -0.5), end=(-6.0, -0.5)),
            "out": LineGuide(start=(6.0, -0.5), end=(90.0, -0.5)),
        },
        "sensors": {
            "gate": Sensor(position=(25.0, 0.0), direction=(1.0, 0.0)),
            "exit": Sensor(position=(-15.0, 0.0), direction=(1.0, 0.0)),
        },
        "goal": "exit",
        "duration": 0.1,
    }
    return Scene(**(parts | changes))


@pytest.fixture(scope="module")
def run() -> diffeed.Trajectory:
    return diffeed.simulate(nip(), dt=1e-4, frames=21, observe=ALL)


def test_arrivals_are_where_speed_and_distance_put_them(run):
    """5 mm at 100 mm/s after a ramp that loses 10 ms: 0.06 s, within the creep of a nip that carries next to nothing."""
    assert float(measures.arrival(nip(), run, "a", "gate")) == pytest.approx(0.06, abs=4e-4)
    assert float(measures.arrival(nip(), run, "a", "exit", "tail")) == pytest.approx(0.06, abs=4e-4)
    assert measures.arrival(nip(), run, "a", "gate", "tail") == jnp.inf


def test_names_that_a_scene_has_not_are_told(run):
    for words, told in (
        (("b", "gate"), 'no sheet named "b"; known: "a"'),
        (("a", "gaet"), 'no sensor named "gaet"; did you mean "gate"?'),
        (("a", "gate", "side"), 'no edge named "side"; known: "lead", "tail"'),
    ):
        with pytest.raises(ValueError, match=f"^{re.escape(told)}$"):
            measures.arrival(nip(), run, *words)
    for part, sheet, told in (("tabel", None, 'roller or guide named "tabel"'), ("table", "b", 'sheet named "b"')):
        with pytest.raises(ValueError, match=f"no {told}"):
            measures.attack_angle(nip(), run, part, sheet)


def test_nip_carries_preload_and_weight(run):
    stats = run.observed["nips"]["pinch"]
    assert float(stats.force_mean) == pytest.approx(3.0 + 0.02 * 9.81, rel=2e-3)
    assert float(stats.contact_time) == pytest.approx(0.1)
    assert float(stats.force_peak) >= float(stats.force_mean)


def test_progress_counts_fed_over_commanded(run):
    assert float(measures.progress(nip(), run)["a"]) == pytest.approx(1.0, abs=5e-3)
    feed = run.observed["feed"]["a"]
    assert float(feed.commanded) == pytest.approx(9.0, rel=2e-3)


@pytest.mark.long
def test_what_a_roller_turns_is_fed_or_slips(run):
    """Also of a sheet that moves aside where it is bent, as all of it then is not as fast along itself as in the nip."""
    bent = replace(nip(), sheets={"a": replace(nip().sheets["a"], curl=0.01)}, guides={}, gravity=(0.0, 0.0))
    other = diffeed.simulate(bent, duration=0.03, dt=5e-4, frames=2, observe=("nips", "feed"))
    for found in (run, other):
        feed, drive = found.observed["feed"]["a"], found.observed["nips"]["drive"]
        slipped = float(drive.slip_mean * drive.contact_time)
        assert float(feed.driven) == pytest.approx(float(feed.commanded) - slipped, rel=1e-9)


def test_creep_floor_is_the_inverse_of_the_law(run):
    """At the mean square friction of the run, v/sqrt(v^2 + vs^2) = load/(mu N) gives the floor back."""
    stats, floor = run.observed["nips"]["drive"], float(measures.creep_floor(nip(), run)["drive"])
    load = float(stats.friction_rms / (0.8 * stats.force_mean))
    assert floor / np.hypot(floor, 3.0) == pytest.approx(min(load, 0.95), rel=1e-9)
    assert float(measures.slip(nip(), run)["drive"].floor) == floor


@pytest.mark.long
def test_creep_floor_where_friction_falls_with_speed():
    """All that this nip slips under a steady drag is creep, and the floor says so."""
    scene = nip(
        loads={"drag": diffeed.Load(sheet="a", at="tail", force=(-0.9, 0.0))},
        contacts={"default": diffeed.Contact(static_ratio=2.0)}, guides={}, gravity=(0.0, 0.0),
    )  # fmt: skip
    settled = diffeed.simulate(scene, duration=0.06, dt=1e-4, frames=2)
    start = jax.tree.map(lambda v: v[-1], settled.states)
    run = diffeed.simulate(scene, duration=0.01, dt=1e-4, frames=2, initial=start, observe=("nips",))
    found = measures.slip(scene, run)["drive"]
    assert float(found.floor) > 0.3
    assert float(found.rms) == pytest.approx(float(found.floor), rel=2e-3)


@pytest.mark.long
def test_a_joined_end_is_not_met():
    """The gap to a guide that begins where another ends is that of its face: the tip between them touches nothing."""
    drop = 60.0 * np.tan(np.deg2rad(5.0))
    guides = {
        "a": LineGuide(start=(-100.0, -0.1), end=(0.0, -0.1), friction=0.1),
        "b": LineGuide(start=(0.0, -0.1), end=(60.0, -0.1 - drop), friction=0.1),
    }
    stiff = Sheet(**FILM | {"youngs_modulus": 3e5}, length=40.0, bars=2, lead=(-2.0, 0.0), speed=200.0)
    scene = Scene(sheets={"s": stiff}, guides=guides, initial="given")
    run = diffeed.simulate(scene, duration=0.04, dt=1e-4, frames=41)
    seen = float(np.min(run.guides["b"].gap))
    assert float(jnp.min(measures.attack_angle(scene, run, "b").gap)) >= seen - 1e-9
    pairs = measures.pair_gaps(scene, run)
    assert float(jnp.min(pairs.gap[:, [n == "b" for n in pairs.bodies]])) == pytest.approx(seen, abs=1e-9)


@pytest.mark.long
def test_rollers_that_meet_no_sheet_have_no_torque_of_one():
    aside = nip(sheets={"a": Sheet(length=40.0, bars=4, lead=(200.0, 60.0), **FILM)}, guides={}, gravity=(0.0, 0.0))
    run = diffeed.simulate(aside, dt=1e-4, frames=3, observe=("nips",))
    stats = run.observed["nips"]["pinch"]
    assert float(stats.contact_time) == float(stats.torque_peak) == 0.0
    assert float(run.rollers["pinch"].angular_velocity[-1]) > 5.0


@pytest.mark.long
@pytest.mark.parametrize("slick", ["drive", "pinch"])
def test_a_roller_without_friction_turns_no_other(slick):
    """Whichever of the two has the law "none"."""
    scene = nip(sheets={"a": Sheet(length=40.0, bars=4, lead=(200.0, 60.0), **FILM)}, guides={}, gravity=(0.0, 0.0))
    rollers = scene.rollers | {slick: replace(scene.rollers[slick], contact="slick")}
    scene = replace(scene, rollers=rollers, contacts={"slick": diffeed.Contact(friction_law="none")})
    run = diffeed.simulate(scene, dt=1e-4, frames=3)
    assert np.all(np.asarray(run.rollers["pinch"].angular_velocity) == 0.0)


@pytest.mark.long
def test_drag_shows_as_friction_and_torque():
    """A load of 0.5 N against the feed: the nip pulls with it, and the drive's contact torque is that times its radius."""
    load = {"drag": diffeed.Load(sheet="a", at="tail", force=(-0.5, 0.0))}
    run = diffeed.simulate(nip(loads=load, guides={}, gravity=(0.0, 0.0)), dt=1e-4, frames=21, observe=ALL)
    drive, pinch = run.rollers["drive"], run.rollers["pinch"]
    assert float(drive.friction[-1] + pinch.friction[-1]) == pytest.approx(0.5, rel=1e-3)
    assert float(pinch.friction[-1]) == pytest.approx(0.0, abs=1e-3)  # it turns freely
    assert float(drive.torque[-1]) == pytest.approx(0.5 * 10.0, rel=1e-3)
    # Slip to carry it: v/sqrt(v^2 + vs^2) = 0.5/(0.8 N).
    share = 0.5 / (0.8 * float(drive.force[-1]))
    assert float(drive.slip[-1]) == pytest.approx(3.0 * share / np.sqrt(1.0 - share**2), rel=1e-3)


@pytest.mark.slow
def test_energy_balance_closes_as_the_step_shrinks():
    gaps = []
    for dt in (2e-4, 5e-5):
        run = diffeed.simulate(nip(), dt=dt, frames=3, observe=("energy",))
        balance = measures.energy_balance(nip(), run)
        gaps.append(abs(float(balance["numerical"])) / float(balance["work of drives"]))
    assert gaps[1] < 0.6 * gaps[0]
    assert gaps[1] < 0.1


@pytest.mark.long
def test_the_energy_balance_of_a_run_that_goes_on_is_that_of_the_whole():
    asked = {"dt": 1e-4, "observe": ("energy",)}
    whole = diffeed.simulate(nip(), duration=0.04, frames=5, **asked)
    half = diffeed.simulate(nip(), duration=0.02, frames=3, **asked)
    rest = diffeed.simulate(nip(), duration=0.02, frames=3, initial=half.final, **asked)
    expected = measures.energy_balance(nip(), whole)
    for name, value in measures.energy_balance(nip(), rest).items():
        assert float(value) == pytest.approx(float(expected[name]), rel=1e-6, abs=1e-9), name
    change = measures.energy(nip(), whole)["total"]
    assert float(expected["stored"]) == pytest.approx(float(change[-1] - change[0]), rel=1e-9)


@pytest.mark.slow
def test_gaps_reach_parts_that_nothing_touches(run):
    far = diffeed.simulate(
        nip(guides=nip().guides | {"roof": LineGuide(start=(90.0, 7.0), end=(4.0, 7.0))}),
        dt=1e-4,
        frames=3,
        observe=("gaps",),
    )
    assert float(far.observed["gaps"]["guides"]["roof"].gap) == pytest.approx(7.0 - 0.1, abs=0.05)
    found = measures.pair_gaps(nip(), run)
    assert found.gap.shape == (21, len(found.bodies), len(found.features))
    assert found.features[0] == "a.0"
    assert found.features[-1] == "a.tail"


@pytest.mark.slow
def test_a_guide_out_of_reach_has_a_gap_with_a_gradient():
    def gap(height):
        scene = nip(guides={"roof": LineGuide(start=(90.0, height), end=(4.0, height))}, gravity=(0.0, 0.0))
        return diffeed.simulate(scene, duration=0.01, dt=1e-3, frames=2).guides["roof"].gap[-1]

    assert float(jax.grad(gap)(20.0)) == pytest.approx(1.0, rel=1e-6)


@pytest.mark.slow
def test_attack_angle_is_that_of_the_ramp():
    """The lead meets a guide inclined by 20 degrees."""
    ramp = LineGuide(
        start=(22.0, -0.5), end=(22.0 + 40.0 * np.cos(np.deg2rad(20)), -0.5 + 40.0 * np.sin(np.deg2rad(20)))
    )
    scene = nip(guides={"table": nip().guides["table"], "ramp": ramp})
    run = diffeed.simulate(scene, dt=1e-4, frames=101)
    attack = measures.attack_angle(scene, run, "ramp")
    assert float(attack.at_contact) == pytest.approx(20.0, abs=2.0)
    assert attack.gap.shape == (101,)


def test_curvature_of_a_circle():
    """Headings that turn by 0.1 rad at each 10 mm joint: 0.01 1/mm."""
    sheet = Sheet(length=40.0, bars=4, headings=tuple(np.rad2deg([0.3, 0.2, 0.1, 0.0])), **FILM)
    scene = Scene(sheets={"a": sheet}, gravity=(0.0, 0.0), initial="given")
    run = diffeed.simulate(scene, duration=1e-5, dt=1e-5, frames=2, observe=("curvature",))
    np.testing.assert_allclose(measures.curvature(scene, run)["a"][0], 0.01, rtol=1e-9)
    assert float(run.observed["curvature"]["a"]) == pytest.approx(0.01, rel=1e-3)


@pytest.mark.long
def test_observations_must_be_asked_for(run):
    bare = diffeed.simulate(nip(), duration=0.01, dt=1e-3, frames=2)
    with pytest.raises(ValueError, match=r'observe=\("nips",\)'):
        measures.slip(nip(), bare)


VERDICTS = {
    "passed": (nip(), "passed", "passed sensor exit"),
    "late": (nip(speed=40.0), "late", "has not passed sensor exit at the end of the run: it is "),
    "stalled at a stop": (  # so stiff that the drive slips before the sheet buckles
        diffeed.put(
            nip(guides=nip().guides | {"wall": LineGuide(start=(22.0, -9.0), end=(22.0, 9.0))}),
            "sheets.a.youngs_modulus",
            3e5,
        ),
        "jammed",
        "a stalled; drive slips on it at 100 mm/s, lead edge at (21.9, ",
    ),
    "no nip holds it": (
        nip(rollers={"drive": nip().rollers["drive"]}, clamps={"c": Clamp(sheet="a", at="tail")}),
        "jammed",
        "stalled",
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("case", VERDICTS)
def test_verdicts(case):
    scene, status, fragment = VERDICTS[case]
    run = diffeed.simulate(scene, dt=2e-4, frames=51)
    verdict = measures.verdict(scene, run)
    found = measures.outcome(scene, run)
    assert measures.STATUSES[int(found.status)] == status
    assert verdict.time == (pytest.approx(float(found.time)) if np.isfinite(found.time) else None)
    assert verdict.status == status, verdict
    assert fragment in verdict.sentence()


@pytest.mark.long
def test_two_drives_against_each_other_are_told():
    """The second turns the other way: the sheet stalls between them, or is torn about."""
    first = nip().rollers
    second = {"behind": replace(first["drive"], center=(-15.0, -4.1), radius=4.0, angular_speed=10.0)}
    second |= {"above": replace(first["pinch"], center=(-15.0, 4.1), radius=4.0)}
    scene = nip(rollers=first | second)
    run = diffeed.simulate(scene, dt=2e-4, frames=51)
    said = measures.verdict(scene, run).reason
    assert "; drive drives it forwards and behind backwards at the same time" in said
    alike = nip(
        rollers=first | second | {"behind": replace(second["behind"], angular_speed=first["drive"].angular_speed)}
    )
    assert "backwards" not in measures.verdict(alike, diffeed.simulate(alike, dt=2e-4, frames=51)).reason


@pytest.mark.long
def test_a_pinch_that_never_reaches_a_sheet_that_stops_is_told():
    """Held off by its stop, 0.8 mm above a sheet that is flat. One that the lead has not come to is none of it."""
    stiff, stopped, _ = VERDICTS["stalled at a stop"]
    first = stiff.rollers
    above = replace(first["pinch"], center=(-10.0, 4.9), radius=4.0, travel_min=0.0)
    ahead = replace(above, center=(35.0, 4.9))
    scene = replace(stiff, rollers=first | {"above": above, "ahead": ahead})
    verdict = measures.verdict(scene, diffeed.simulate(scene, dt=2e-4, frames=51))
    assert verdict.status == stopped
    assert re.fullmatch(r"a stalled; drive slips on it at 100 mm/s; above stays 0\.[4-8]\d? mm off it", verdict.reason)


@pytest.mark.long
def test_a_sensor_that_looks_the_wrong_way_is_told():
    back = nip(sensors=nip().sensors | {"exit": Sensor(position=(-15.0, 0.0), direction=(-1.0, 0.0))})
    run = diffeed.simulate(back, dt=2e-4, frames=51)
    verdict = measures.verdict(back, run)
    assert verdict.status == "late"
    assert verdict.reason.endswith("; its tail passed sensor exit against the sensor's direction")


@pytest.mark.long
def test_a_sensor_beside_the_path_is_told():
    aside = nip(sensors=nip().sensors | {"exit": Sensor(position=(-15.0, 40.0), direction=(1.0, 0.0), range=20.0)})
    verdict = measures.verdict(aside, diffeed.simulate(aside, dt=5e-4, frames=51))
    assert verdict.status == "late"
    assert verdict.reason.endswith("; its tail passed 40 mm beside sensor exit, whose range is 20 mm")


@pytest.mark.parametrize("read", [measures.verdict, measures.jam_margins, measures.energy])
def test_arguments_in_the_wrong_order_are_told(read, run):
    with pytest.raises(TypeError, match="a Scene is needed here, but this is a Trajectory"):
        read(run, nip())
