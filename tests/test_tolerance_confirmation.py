"""Whether the samples of a study come out the same in shorter steps."""

import numpy as np
import pytest
from test_tolerance_study import problem

from optimize.tolerance import confirmation
from optimize.tolerance.confirmation import _change, confirm, picked
from optimize.tolerance.study import here, run_study
from optimize.tolerance.summary import summarise


@pytest.fixture(scope="module")
def rows():
    return run_study(problem(), here(problem(), 8))


@pytest.mark.long
def test_samples_are_run_again_in_shorter_steps(rows):
    """The force of this nip is the same in any steps, whether it is above its limit too. How far it feeds while its drive runs
    up, which hardly scatters, is not: it is more for all, and for some more than for others."""
    found = confirm(problem(), rows)
    assert found.holds
    assert (found.shifted, found.unsure) == (["fed"], ["fed"])
    assert found.passed.of == found.others.of == 2
    assert found.changes["force"].std < 1e-3 * found.changes["force"].scatter
    assert found.sentence() == (
        "4 samples run again in steps 4 times as fine: of 2 that passed 2 pass too, of 2 that did not 2 do not either. Finer "
        f"steps shift all of them: fed by {found.changes['fed'].mean:.3g}. Of the scatter of fed the steps make a good part. A "
        "smaller --dt tells more."
    )


@pytest.mark.parametrize(
    ("more", "shifted", "unsure"),
    [
        ([0.0, 0.0, 0.0, 0.0], False, False),
        ([1e-13, -1e-13, 1e-13, -1e-13], False, False),
        ([0.5, 0.5, 0.5, 0.5], True, False),
        ([0.5, -0.5, 0.5, -0.5], False, True),
        ([0.0, 1.0, 0.0, 1.0], True, True),
        ([np.nan] * 4, False, False),
    ],
)
def test_a_shift_of_all_is_no_scatter(more, shifted, unsure):
    change = _change(np.array(more), np.array([9.0, 10.0, 10.0, 11.0]))
    assert (change.counts(change.mean), change.counts(change.std)) == (shifted, unsure)
    alike = _change(np.array(more) * 1e-3, np.full(4, 10.0))  # of what does not scatter everything else is a good part
    assert (alike.counts(alike.mean), alike.counts(alike.std)) == (shifted, unsure)


@pytest.mark.long
def test_what_the_steps_decide_is_told(rows, monkeypatch):
    """As if every run in shorter steps had passed, with forces that scatter otherwise."""

    def lenient(problem, chunk):
        def run(sample, deviation):
            for got in here(problem, chunk)(sample, deviation):
                more = np.stack([np.zeros(len(got.status)), 0.2 * (-1.0) ** np.arange(len(got.status))], axis=1)
                yield got._replace(status=0 * got.status, broken=np.zeros_like(got.broken), values=got.values + more)

        return run

    monkeypatch.setattr(confirmation, "here", lenient)
    study = problem(step_tolerance=0.01)
    found = confirm(study, rows)
    assert not found.holds
    assert found.others == (0, 2)
    assert found.parted.tolist() == found.samples[~rows.passed[found.samples]].tolist()
    assert found.unsure == ["fed", "force"]
    assert f"The steps decide on the others ({found.parted[0]}, {found.parted[1]})." in found.sentence()
    assert "Of the scatter of fed, force the steps make a good part." in found.sentence()
    assert found.sentence().endswith("A smaller step_tolerance of the study tells more.")
    told = summarise(study, rows, confirmed=found)["confirmed"]
    assert (told["others"], told["parted"]) == ({"same": 0, "of": 2}, found.parted.tolist())


@pytest.mark.parametrize(
    ("passed", "others", "again"),
    [
        (1000, 0, (0, 16)),
        (0, 1000, (16, 0)),
        (1000, 3, (3, 13)),
        (1, 1000, (15, 1)),
        (100, 100, (6, 6)),
        (2, 1, (1, 2)),
        (20, 4, (2, 2)),
    ],
)
def test_which_samples_are_run_again(passed, others, again):
    found = np.random.default_rng(0).permutation(np.arange(passed + others) < passed)
    which = picked(found)
    assert len(np.unique(which)) == len(which)
    assert (int((~found[which]).sum()), int(found[which].sum())) == again


def test_steps_that_are_too_many_are_not_run_again(rows):
    with pytest.raises(ValueError, match="dt"):
        confirm(problem().changed(dt=1e-11), rows)
