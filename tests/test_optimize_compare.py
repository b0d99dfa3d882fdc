"""The comparison with gradient-free search: how it counts."""

import json

import numpy as np
import pytest
from test_optimize_search import problem_of

from optimize import compare
from optimize.compare import Comparison, Trace, picture, reached, table, write_comparison
from optimize.evaluate import Counts

GRADIENT = Trace("gradient", np.array([1.0, 5.0, 10.0]), np.array([10.0, 5.0, 1.0]))
SLOW = Trace("Nelder-Mead", np.array([1.0, 2.0, 3.0, 40.0]), np.array([10.0, 8.0, 8.0, 1.0]))
LOST = Trace("differential evolution", np.array([1.0, 30.0]), np.array([10.0, 2.0]))
FOUND = Comparison([GRADIENT, SLOW, LOST], target=1.02, ratio=4.0, variables=3)


def test_the_cost_at_which_the_target_is_reached():
    assert reached(GRADIENT, 1.02) == 10.0
    assert reached(GRADIENT, 5.0) == 5.0
    assert reached(LOST, 1.02) is None


def test_the_table_gives_times_of_the_gradient():
    rows = table(FOUND).splitlines()
    assert rows[2].split()[-3:] == ["10", "1.0", "1"]
    assert rows[3].split()[-3:] == ["40", "4.0", "1"]
    assert "not reached" in rows[4]
    assert rows[4].split()[-3:] == [">", "3.0", "2"]


def test_the_file_holds_every_gain(tmp_path):
    assert write_comparison(tmp_path / "new", FOUND) == ["comparison.png", "comparison.json"]  # the numbers last
    data = json.loads((tmp_path / "new" / "comparison.json").read_text())
    assert data["searches"]["Nelder-Mead"]["falls"] == [[1.0, 10.0], [2.0, 8.0], [40.0, 1.0]]
    assert data["searches"]["Nelder-Mead"]["forward_runs"] == pytest.approx(40.0)
    assert (tmp_path / "new" / "comparison.png").stat().st_size > 5_000


@pytest.mark.usefixtures("as_users_have_it")
def test_the_gradient_pays_for_all_its_runs(monkeypatch):
    """Two starts and two media; in the second iteration a line search looks at three more points. A point has two gradients,
    and all starts count."""
    problem = problem_of(media={"thin": {}, "thick": {}}, search={"starts": 2})

    def searched(problem, progress):
        progress.good = np.array([[0.5], [0.2]])
        for progress.iteration, gradients in enumerate((4, 4 + 4 + 3 * 2, 1000), 1):
            progress.counts = Counts(gradients, gradients)
            yield progress, None

    monkeypatch.setattr(compare, "search", searched)
    found = compare._gradient(problem, lambda unit: float(unit[0]), ratio=3.0, budget=100, at_start=1.0)
    assert found.cost == pytest.approx([1.0, 3.0 * 2, 3.0 * 7])
    assert found.best == pytest.approx([1.0, 0.2, 0.2])


# --- searches that find nothing -----------------------------------------------------------------------------------------


def test_the_best_of_all_comes_down_to_the_axis():
    """Two of three found 1: their curves end at the bottom; a logarithm alone would leave out that they did."""
    drawn = picture(FOUND)
    ends = {line.get_label(): line.get_ydata()[-1] for line in drawn.lines}
    assert ends["gradient"] == ends["Nelder-Mead"] >= drawn.get_ylim()[0]
    assert ends["gradient"] < ends["target 1.02"] < ends["differential evolution"] == 1.0
    assert drawn.get_title(loc="left") == "At the bottom: the best found, 1"


def ended(*bests):
    """A comparison of searches with these best values over their first runs; the first is the gradient's."""
    traces = [
        Trace(t.name, np.arange(1.0, len(b) + 1.0), np.array(b, float))
        for t, b in zip(FOUND.traces, bests, strict=True)
    ]
    found = traces[0].best[-1]
    return Comparison(traces, float(found + 0.02 * abs(found)), ratio=2.0, variables=1)


INF = np.inf
NOTHING = pytest.mark.parametrize(
    ("found", "said"),
    [
        (ended([1], [1] * 5, [1] * 5), "no search found a point better than the start"),
        (ended([0], [0, 0], [0, 0]), "no search found a point better than the start"),
        (ended([-2], [-2, -2], [-2, -3]), "the gradient found no point better than the start, which is the target"),
        (ended([INF], [INF, 2], [INF, 1.5]), "the gradient found no point at which the run holds: there is no target"),
        (ended([INF], [INF, INF], [INF, INF]), "no search found a point at which the run holds"),
        (ended([INF, 1], [INF, 2], [INF, 1.5]), ""),
    ],
)  # fmt: skip


@NOTHING
def test_what_was_not_found_is_said_and_not_counted(found, said):
    """A search that found no point has reached nothing, and the table says so in a sentence."""
    rows = table(found).splitlines()
    assert rows[5:] == ([said] if said else [])
    held = np.isfinite(found.traces[0].best[-1])
    assert ("no target" in rows[0]) == (not held)
    assert any(reached(t, found.target) is not None for t in found.traces) == held
    assert "inf" not in "\n".join(rows)


@NOTHING
@pytest.mark.filterwarnings("error")
def test_the_result_is_written_whatever_was_found(found, said, tmp_path):
    """JSON that every reader takes, and a picture that says when there is nothing to draw."""
    write_comparison(tmp_path, found)
    text = (tmp_path / "comparison.json").read_text()
    data = json.loads(text, parse_constant=pytest.fail)  # Infinity, NaN
    best = found.traces[0].best[-1]
    assert data["searches"]["gradient"]["best"] == (best if np.isfinite(best) else None)
    assert (tmp_path / "comparison.png").stat().st_size > 5_000


def test_the_numbers_are_kept_where_a_picture_fails(monkeypatch, tmp_path):
    """Searches take hours, a picture a second: the numbers are written before it is drawn."""
    monkeypatch.setattr(compare, "picture", lambda found: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_comparison(tmp_path, FOUND)
    assert json.loads((tmp_path / "comparison.json").read_text())["target"] == 1.02
