"""What sample i draws: families, independence, groups, the same numbers whatever the batch; and what is refused."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from stand_in_nip import nip

import diffeed
from optimize.asked import StudyError
from optimize.tolerance.draws import correlation, correlation_of_deviations, deviations, epsilons, uniforms
from optimize.tolerance.media import MOVING, find
from optimize.tolerance.moves import sampled
from optimize.tolerance.problem import at_axes, make_tolerance, packed, unpacked

PINCH = {"path": "rollers.pinch.preload", "sigma": 0.1}
BASE = {"scene": "nip", "duration": 0.01, "dt": 2e-4, "frames": 5, "tolerances": {"preload": PINCH}}


def problem(**changes):
    return make_tolerance(BASE | changes, scene=nip())


def drawn(study, samples, sampling="plain", seed=0):
    return deviations(study.inputs, uniforms(study.inputs, sampling, samples, seed))


@pytest.mark.parametrize(
    ("spec", "sigma", "far"),
    [
        ({"sigma": 0.1}, 0.1, np.inf),
        ({"tolerance": 0.3}, 0.1, np.inf),
        ({"tolerance": 0.3, "sigmas": 2}, 0.15, np.inf),
        ({"tolerance": 0.3, "kind": "uniform"}, 0.3 / np.sqrt(3), 0.3),
        ({"sigma": 0.1, "kind": "uniform"}, 0.1, 0.1 * np.sqrt(3)),
        ({"tolerance": 0.3, "kind": "triangular"}, 0.3 / np.sqrt(6), 0.3),
        ({"sigma": 0.1, "kind": "log_normal"}, 0.1, np.inf),
        ({"sigma": 0.1, "limits": [-0.1, 0.2], "kind": "truncated_normal"}, 0.1 * stats.truncnorm.std(-1, 2), 0.2),
        ({"tolerance": 0.3, "kind": "truncated_normal"}, 0.1 * stats.truncnorm.std(-3, 3), 0.3),
    ],
)  # fmt: skip
def test_each_family_has_its_spread_and_its_ends(spec, sigma, far):
    study = problem(tolerances={"preload": {"path": "rollers.pinch.preload"} | spec})
    found = drawn(study, 4096, "sobol")[:, 0]
    assert study.inputs[0].sigma == pytest.approx(sigma, rel=1e-12)
    assert np.std(found) == pytest.approx(sigma, rel=0.01)
    assert np.max(np.abs(found)) <= far


def test_an_offset_moves_the_mean():
    found = drawn(problem(tolerances={"wear": PINCH | {"offset": -0.05}}), 4096, "sobol")
    assert np.mean(found) == pytest.approx(-0.05, abs=1e-3)


def test_measured_values_are_drawn_as_they_were_measured(tmp_path):
    (tmp_path / "parts.csv").write_text("name,preload\na,2.5\nb,3.5\nc,3.0\n")
    spec = {"path": "rollers.pinch.preload", "kind": "data", "file": "parts.csv", "column": "preload"}
    study = make_tolerance(BASE | {"tolerances": {"preload": spec}}, folder=tmp_path, scene=nip())
    found = drawn(study, 1024, "sobol")[:, 0] + 3.0
    assert found.min() >= 2.5
    assert found.max() <= 3.5
    assert np.median(found) == pytest.approx(3.0, abs=0.01)
    bad = spec | {"column": "prelaod"}
    with pytest.raises(StudyError, match=r'has no column "prelaod"; did you mean "preload"'):
        make_tolerance(BASE | {"tolerances": {"preload": bad}}, folder=tmp_path, scene=nip())


def test_decimal_commas_and_limits_of_measured_values_are_refused(tmp_path):
    """One as a second column that has no heading, the other as something that nothing would heed."""
    (tmp_path / "parts.csv").write_text("preload\n2,5\n3,5\n")
    spec = {"path": "rollers.pinch.preload", "kind": "data", "file": "parts.csv", "column": "preload"}
    with pytest.raises(StudyError, match=r"line 2 has more entries than there are headings \(decimal commas\?\)"):
        make_tolerance(BASE | {"tolerances": {"preload": spec}}, folder=tmp_path, scene=nip())
    with pytest.raises(StudyError, match='limits belong to kind = "truncated_normal"'):
        make_tolerance(BASE | {"tolerances": {"preload": spec | {"limits": [-0.1, 0.1]}}}, folder=tmp_path, scene=nip())


def test_like_parts_are_independent_unless_tied():
    both = {"path": ["rollers.drive.radius", "rollers.pinch.radius"], "sigma": 0.01}
    apart = problem(tolerances={"radius": both})
    assert [i.name for i in apart.inputs] == ["radius[drive]", "radius[pinch]"]
    assert abs(np.corrcoef(drawn(apart, 4096).T)[0, 1]) < 0.05
    tied = problem(tolerances={"radius": both | {"tied": True}})
    assert [i.name for i in tied.inputs] == ["radius"]


def test_deviations_that_are_not_normal_go_together_less(tmp_path):
    """Under a Gaussian copula of rho two signs correlate by 2/pi asin rho, two uniform numbers by 6/pi asin rho/2."""
    (tmp_path / "signs.csv").write_text("v\n" + "-1\n1\n" * 50)
    pair = {"path": ["rollers.drive.friction", "rollers.pinch.friction"], "group": "g", "correlation": 0.6}
    signs = pair | {"kind": "data", "file": "signs.csv", "column": "v"}
    for spec, expected in (
        (signs, 2 / np.pi * np.arcsin(0.6)),
        (pair | {"kind": "uniform", "tolerance": 0.1}, 6 / np.pi * np.arcsin(0.3)),
    ):
        study = make_tolerance(BASE | {"tolerances": {"rubber": spec, "preload": PINCH}}, folder=tmp_path, scene=nip())
        found = correlation_of_deviations(study.inputs)
        assert found == pytest.approx(np.array([[1.0, expected, 0.0], [expected, 1.0, 0.0], [0.0, 0.0, 1.0]]), abs=0.01)
        assert correlation(study.inputs)[0, 1] == pytest.approx(0.6)


def test_numbers_of_one_part_have_names_of_their_own():
    place = {"path": ["rollers.pinch.center[0]", "rollers.pinch.center[1]"], "sigma": 0.01}
    sheet = {"path": ["sheets.strip.thickness", "sheets.strip.curl"], "sigma": 1e-4}
    study = problem(tolerances={"place": place, "sheet": sheet})
    paths = [*(f"place[{p}]" for p in place["path"]), *(f"sheet[{p}]" for p in sheet["path"])]
    assert [i.name for i in study.inputs] == paths


def test_a_group_is_drawn_together():
    rubber = {"path": ["rollers.drive.friction", "rollers.pinch.friction"], "sigma": 0.05, "group": "batch"}
    study = problem(tolerances={"rubber": rubber | {"correlation": 0.6}, "preload": PINCH})
    found = np.corrcoef(drawn(study, 8192, "sobol").T)
    assert found[0, 1] == pytest.approx(0.6, abs=0.02)
    assert abs(found[0, 2]) < 0.03
    assert np.std(drawn(study, 8192, "sobol"), axis=0) == pytest.approx([0.05, 0.05, 0.1], rel=0.02)


@pytest.mark.parametrize("sampling", ["plain", "sobol"])
def test_sample_i_does_not_depend_on_how_many_there_are(sampling):
    study = problem()
    assert np.array_equal(drawn(study, 100, sampling)[:37], drawn(study, 37, sampling))
    assert not np.array_equal(drawn(study, 37, sampling, 1), drawn(study, 37, sampling))


def test_latin_hypercube_has_one_sample_in_each_row():
    u = uniforms(problem().inputs, "latin_hypercube", 50, 3)
    assert np.array_equal(np.sort(np.floor(50 * u[:, 0])), np.arange(50))


def test_deviates_are_what_the_deviations_are_made_of():
    study = problem(tolerances={"preload": PINCH | {"offset": 0.02}})
    u = uniforms(study.inputs, "plain", 20, 0)
    assert deviations(study.inputs, u) == pytest.approx(0.02 + 0.1 * epsilons(study.inputs, u))


def test_a_problem_survives_the_way_to_another_machine():
    study = problem(measures={"force": {"measure": "nip_force", "of": "pinch"}})
    there = unpacked(packed(study))
    assert there.key == study.key
    assert [i.name for i in there.inputs] == [i.name for i in study.inputs]


def test_studies_whose_numbers_are_drawn_in_another_order_are_not_the_same():
    radius = {"path": "rollers.drive.radius", "sigma": 0.01}
    one, other = {"preload": PINCH, "radius": radius}, {"radius": radius, "preload": PINCH}
    assert problem(tolerances=one).key != problem(tolerances=other).key


def test_a_longest_step_that_is_not_given_is_no_bound_on_any_machine():
    chosen = {k: v for k, v in BASE.items() if k != "dt"} | {"step_tolerance": 1e-3}
    study, bounded = (make_tolerance(table, scene=nip()) for table in (chosen, chosen | {"dt": 1e-4}))
    assert study.study.dt == bounded.study.dt, "the default has another value: this test says nothing"
    assert study.key != bounded.key
    for one, dt in ((study, None), (bounded, 1e-4)):
        there = unpacked(packed(one))
        assert there.study.stepping["dt"] == dt
        assert there.key == one.key


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tolerances": {"a": {"path": "rollers.pnich.preload", "sigma": 0.1}}},
         'tolerances.a: "rollers.pnich.preload": rollers has no "pnich"; did you mean "pinch"?'),
        ({"tolerances": {"a": {"path": "sheets.strip.bars", "sigma": 0.1}}}, '"sheets.strip.bars" is not a number'),
        ({"tolerances": {"a": {"path": "rollers.pinch.center", "sigma": 0.1}}}, "holds 2 numbers"),
        ({"tolerances": {"a": {"path": "rollers.pinch.travel_max", "sigma": 0.1}}}, "holds nothing"),
        ({"tolerances": {"a": {"path": "rollers.drive.angular_speed", "sigma": 0.1}}},
         "path must name one number, but rollers.drive.angular_speed holds Profile("),
        ({"tolerances": {"a": {"path": ["rollers.pinch.preload"] * 2, "sigma": 0.1}}},
         "tolerances.a: each number or part must be named once, but rollers.pinch.preload is named again"),
        ({"tolerances": {"a": PINCH | {"sigma": -0.1}}}, "tolerances.a.sigma must be greater than 0, but is -0.1"),
        ({"tolerances": {"a": PINCH | {"tolerance": 0.1}}}, "exactly one of tolerance and sigma must be given"),
        ({"tolerances": {"a": PINCH | {"kind": "truncated_normal", "limits": [0.1, 0.2]}}},
         "must hold the nominal value, 0, between them, but are [0.1, 0.2]"),
        ({"tolerances": {"a": PINCH | {"limits": [-0.1, 0.2]}}}, 'limits belong to kind = "truncated_normal"'),
        ({"tolerances": {"a": {"path": "gravity[0]", "relative": True, "sigma": 0.1}}},
         "a share of a number that is 0 is always 0"),
        ({"tolerances": {"a": PINCH | {"sigm": 1}}}, 'tolerances.a.sigm is not a field here; did you mean "sigma"?'),
        ({"tolerances": {"a": {"climate": "strip", "sigma": 0.3}}}, 'climate needs a card for sheet "strip"'),
        ({"media": {"strip": "copy_papr_80"}}, "copy_paper_80"),
        ({"media": {"strop": "copy_paper_80"}}, 'there is no sheet "strop"; did you mean "strip"?'),
        ({"limits": {"f": {"measure": "nip_force", "of": "pnich", "at_most": 1}}}, 'there is no "pnich"'),
        ({"method": "euler"}, "method must be one of"),
        ({"samples": 0}, "samples must be greater than or equal to 1, but is 0"),
        ({"latitude": {"x": {"path": "sheets.strip.curl", "range": [0.1, -0.1]},
                       "y": {"path": "sheets.strip.thickness", "range": [0.1, 0.2]}}}, "lower < upper"),
        ({"latitude": {"x": {"path": "sheets.strip.crul", "range": [-0.1, 0.1]},
                       "y": {"path": "sheets.strip.thickness", "range": [0.1, 0.2]}}}, 'did you mean "curl"'),
        ({"latitude": {"x": {"path": "rollers.pinch.center", "range": [-0.1, 0.1]},
                       "y": {"path": "sheets.strip.thickness", "range": [0.1, 0.2]}}},
         "latitude.x: path must name one number, but rollers.pinch.center holds 2 numbers"),
        ({"latitude": {"x": {"path": "sheets.strip.curl", "range": [-0.1, 0.1]},
                       "y": {"path": "rollers.pinch.travel_max", "range": [0.1, 0.2]}}},
         "latitude.y: path must name one number, but rollers.pinch.travel_max holds nothing"),
        ({"latitude": {"x": {"path": ["sheets.strip.curl", "sheets.strip.thickness"], "range": [-0.1, 0.1]},
                       "y": {"path": ["sheets.strip.thickness"], "range": [0.1, 0.2]}}},
         "latitude.y.path must name other numbers than latitude.x, but names sheets.strip.thickness again"),
        ({"media": {"strip": "copy_paper_80"},
          "latitude": {"x": {"climate": "strip", "range": [-1, 0]}, "y": {"climate": "strip", "range": [-1, 1]}}},
         "latitude.y.climate must name another sheet than latitude.x, but names strip again"),
        ({"media": {"strip": "copy_paper_80"},
          "tolerances": {"a": {"climate": "strip", "sigma": 0.1}, "b": {"climate": "strip", "sigma": 0.1}}},
         "tolerances.b.climate must name another sheet than tolerances.a, but names strip again"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused_in_one_sentence(changes, message):
    with pytest.raises(StudyError) as caught:
        problem(**changes)
    assert message in str(caught.value)


def test_a_media_card_comes_into_the_scene_and_its_climate_may_scatter():
    study = problem(media={"strip": "copy_paper_80/humid"}, tolerances={"air": {"climate": "strip", "sigma": 0.3}})
    assert float(study.scene.sheets["strip"].thickness) == pytest.approx(0.1, abs=0.02)
    assert study.inputs[0].climate[2] == 1.0


def test_a_card_comes_before_what_scatters_about_it(tmp_path):
    (tmp_path / "sheets.csv").write_text("caliper\n0.10\n0.11\n")
    spec = {"path": "sheets.strip.thickness", "kind": "data", "file": "sheets.csv", "column": "caliper"}
    changes = {"media": {"strip": "copy_paper_80"}, "tolerances": {"caliper": spec}}
    study = make_tolerance(BASE | changes, folder=tmp_path, scene=nip())
    assert study.inputs[0].nominal == pytest.approx(float(study.scene.sheets["strip"].thickness))
    found = drawn(study, 64)[:, 0] + float(study.scene.sheets["strip"].thickness)
    assert found.min() >= 0.10
    assert found.max() <= 0.11


AIR = {"climate": "strip", "sigma": 0.3}


@pytest.mark.parametrize("quantity", MOVING)
@pytest.mark.parametrize("relative", [False, True])
def test_a_climate_takes_nothing_from_what_scatters_about_it(quantity, relative):
    """Whichever stands first in the file, a sheet is off by its own share from what the climate makes of it."""
    own = {"path": f"sheets.strip.{quantity}", "sigma": 0.1, "relative": relative}
    found = []
    for tolerances in ({"own": own, "air": AIR}, {"air": AIR, "own": own}):
        study = problem(media={"strip": "copy_paper_80/humid"}, tolerances=tolerances)
        assert [i.name for i in study.inputs] == list(tolerances)
        by = {"own": 0.25, "air": -0.5}
        moved = sampled(study.inputs, study.scene, jnp.asarray([by[i.name] for i in study.inputs]))
        found.append(float(diffeed.get(moved, own["path"])))
    of_climate = float(find("copy_paper_80")[0].at(quantity, 0.5))
    assert found == pytest.approx([of_climate * 1.25 if relative else of_climate + 0.25] * 2, rel=1e-6)


def test_a_latitude_sets_a_number_in_any_climate():
    """Curl against climate: the climate moves the rest, whichever axis it is on."""
    curl, air = {"path": "sheets.strip.curl", "range": [-0.01, 0.01]}, {"climate": "strip", "range": [-1, 1]}
    for axes, point in (({"x": curl, "y": air}, (0.004, 0.5)), ({"x": air, "y": curl}, (0.5, 0.004))):
        study = problem(media={"strip": "copy_paper_80"}, latitude=axes)
        sheet = at_axes(study, study.scene, study.study.latitude, jnp.asarray(point)).sheets["strip"]
        assert float(sheet.curl) == pytest.approx(0.004)
        assert float(sheet.youngs_modulus) == pytest.approx(float(find("copy_paper_80")[0].at("youngs_modulus", 0.5)))


def test_measured_values_that_are_tied_stay_so_on_another_machine(tmp_path):
    (tmp_path / "rollers.csv").write_text("radius\n4.9\n5.1\n")
    both = {"path": ["rollers.drive.radius", "rollers.pinch.radius"], "tied": True}
    spec = both | {"kind": "data", "file": "rollers.csv", "column": "radius"}
    study = make_tolerance(BASE | {"tolerances": {"radius": spec}}, folder=tmp_path, scene=nip())
    assert [i.name for i in unpacked(packed(study)).inputs] == ["radius"]


def test_the_correlation_that_is_stated_is_the_one_that_is_drawn():
    rubber = {"path": ["rollers.drive.friction", "rollers.pinch.friction"], "sigma": 0.05, "group": "batch"}
    study = problem(tolerances={"rubber": rubber | {"correlation": 0.6}, "preload": PINCH})
    assert correlation(study.inputs) == pytest.approx(np.array([[1.0, 0.6, 0.0], [0.6, 1.0, 0.0], [0.0, 0.0, 1.0]]))
