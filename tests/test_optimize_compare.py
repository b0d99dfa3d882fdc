"""The comparison with gradient-free search: how it counts."""

import json

import numpy as np
import pytest
from test_optimize_search import problem_of

from optimize import compare
from optimize.compare import Comparison, Trace, reached, table, write_comparison
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
