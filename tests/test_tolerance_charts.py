"""The pictures of tolerances: each returns its axes, says its units and shows what the numbers say."""

from itertools import pairwise
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest

mpl.use("Agg")

from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, QuadMesh
from matplotlib.colors import to_rgba
from matplotlib.container import BarContainer
from matplotlib.contour import ContourSet
from matplotlib.patches import Rectangle, StepPatch
from scipy.stats import binomtest

from optimize.tolerance import charts

NAMES = ["feed.friction", "medium.grammage", "guide.end", "nip.preload"]
SHARES = {"gradient": np.array([0.1, 0.5, 0.05, 0.3]), "Sobol total": np.array([0.2, 0.45, np.nan, 0.25])}
X, Y = np.array([60.0, 80.0, 120.0]), np.array([0.8, 1.0])
MARGIN = np.array([[-1.0, 0.5, 1.0], [0.5, 1.5, np.nan]])


def drawn(ax: Axes) -> Axes:
    """The same axes, once everything in them has been laid out; warnings are errors."""
    assert ax.figure is not None
    ax.figure.canvas.draw()
    assert ax.get_xlabel()
    assert ax.get_ylabel()
    return ax


def legend(ax: Axes) -> list[str]:
    found = ax.get_legend()
    return [] if found is None else [text.get_text() for text in found.get_texts()]


def notes(ax: Axes) -> str:
    return "; ".join(text.get_text() for text in ax.texts)


def line(ax: Axes, name: str):
    return next(artist for artist in ax.lines if str(artist.get_label()).startswith(name))


def places(ax: Axes, name: str) -> np.ndarray:
    return np.asarray(line(ax, name).get_xdata(), float)


def shaded(ax: Axes) -> list[tuple[float, float]]:
    """Ends of the shaded spans."""
    return [(patch.get_x(), patch.get_x() + patch.get_width()) for patch in ax.patches if isinstance(patch, Rectangle)]


def steps(ax: Axes) -> list[Any]:
    return [patch for patch in ax.patches if isinstance(patch, StepPatch)]


def bars(ax: Axes) -> list[np.ndarray]:
    """Lengths of the bars of each series, from the top."""
    found = [held for held in ax.containers if isinstance(held, BarContainer)]
    return [np.array([bar.get_width() for bar in held]) for held in found]


def rows(ax: Axes) -> list[str]:
    return [text.get_text() for text in ax.get_yticklabels()]


def strokes(ax: Axes) -> np.ndarray:
    """Left and right end and height of the horizontal strokes."""
    held = [c for c in ax.collections if isinstance(c, LineCollection)]
    return np.array([[*path[:, 0], path[0, 1]] for c in held for path in c.get_segments() if len(path)])


PICTURES = {
    "histogram": lambda **given: charts.histogram(np.arange(9.0), "arrival, s", (None, 7.5), **given),
    "distribution": lambda **given: charts.distribution(np.arange(9.0), "arrival, s", (None, 7.5), **given),
    "convergence": lambda **given: charts.convergence(*np.array([[1, 9], [0, 0.1], [0, 0.01], [0.9, 0.4]]), **given),
    "contributions": lambda **given: charts.contributions(NAMES, SHARES, **given),
    "gains": lambda **given: charts.gains(NAMES, SHARES["gradient"], SHARES["gradient"], 0.1, **given),
    "latitude": lambda **given: charts.latitude(X, Y, MARGIN, MARGIN > 0.0, "grammage, g/m²", "friction", **given),
}


@pytest.mark.parametrize("name", PICTURES)
def test_makes_axes_or_draws_into_given_ones(name):
    assert isinstance(drawn(PICTURES[name]()), Axes)
    _, ax = pyplot.subplots()
    assert drawn(PICTURES[name](ax=ax)) is ax
    assert len(pyplot.get_fignums()) == 2


@pytest.mark.parametrize(
    ("name", "horizontal", "vertical"),
    [
        ("histogram", "arrival, s", "(%)"),
        ("distribution", "arrival, s", "(%)"),
        ("convergence", "Number of draws", "(%)"),
        ("contributions", "variance (%)", "Deviation"),
        ("gains", "10 % tighter (percentage points)", "Tolerance"),
        ("latitude", "grammage, g/m²", "friction"),
    ],
)
def test_axes_say_their_units(name, horizontal, vertical):
    ax = PICTURES[name]()
    assert horizontal in ax.get_xlabel()
    assert vertical in ax.get_ylabel()


@pytest.mark.parametrize("draw", [charts.histogram, charts.distribution])
class TestValues:
    def test_limits_are_lines_and_what_lies_outside_is_shaded(self, draw):
        ax = drawn(draw(np.linspace(0.0, 10.0, 101), "gap, mm", (2.05, 9.95)))
        assert places(ax, "lower limit 2.05") == pytest.approx(2.05)
        assert places(ax, "upper limit 9.95") == pytest.approx(9.95)
        left, right = ax.get_xlim()
        assert shaded(ax) == [pytest.approx((left, 2.05)), pytest.approx((9.95, right))]
        assert any(f"({100 * 22 / 101:.3g} % outside)" in text for text in legend(ax))

    @pytest.mark.parametrize("limits", [(None, None), (-np.inf, np.inf)])
    def test_no_limit_no_line(self, draw, limits):
        ax = drawn(draw(np.arange(5.0), "gap, mm", limits))
        assert not shaded(ax)
        assert not any("limit" in text or "outside" in text for text in legend(ax))

    def test_a_limit_beyond_the_values_is_in_view(self, draw):
        ax = drawn(draw(np.linspace(0.0, 1.0, 50), "gap, mm", (-3.0, 5.0)))
        assert ax.get_xlim()[0] < -3.0
        assert ax.get_xlim()[1] > 5.0
        assert any("(0 % outside)" in text for text in legend(ax))

    def test_counts_what_is_not_finite(self, draw):
        values = np.r_[np.arange(20.0), np.nan, np.inf, -np.inf]
        ax = drawn(draw(values, "gap, mm", (None, 30.0), before=np.r_[np.arange(20.0), np.nan]))
        assert notes(ax) == "3 of 23 draws not finite; before: 1 of 21 draws not finite"
        assert any("(0 % outside)" in text for text in legend(ax))
        assert notes(draw(np.arange(20.0), "gap, mm", (None, 30.0), before=np.arange(20.0))) == ""

    def test_two_designs_have_a_legend(self, draw):
        ax = drawn(draw(np.arange(10.0), "gap, mm", (None, 7.5), before=np.arange(10.0) + 4.0))
        assert legend(ax)[-3:] == ["after\n(20 % outside)", "before, same draws\n(60 % outside)", "upper limit 7.5"]
        assert ax.get_xlim()[1] > 13.0

    def test_a_few_far_values_do_not_flatten_the_rest(self, draw):
        ax = drawn(draw(np.r_[np.linspace(0.0, 1.0, 400), 1e9], "gap, mm", (None, 2.0)))
        assert ax.get_xlim()[1] < 4.0
        assert notes(ax) == "1 off the scale"

    @pytest.mark.parametrize(
        "values",
        [
            np.array([0.4]),
            np.zeros(9),
            np.full(9, 1e-9),
            np.array([1e9, np.nextafter(1e9, 2e9)]),
            np.full(9, np.nan),
            np.zeros(0),
        ],
        ids=["single", "zeros", "small", "rounding apart", "none finite", "none"],
    )
    @pytest.mark.parametrize("limits", [(None, None), (0.1, None), (0.1, 0.1)])
    def test_draws_whatever_the_values(self, draw, values, limits):
        ax = drawn(draw(values, "gap, mm", limits))
        left, right = ax.get_xlim()
        assert left < right
        if np.isfinite(values).any():
            assert left < values[0] < right
        drawn(draw(values, "gap, mm", limits, before=np.full(3, np.nan)))
        drawn(draw(values, "gap, mm", limits, before=np.array([0.2, 0.3])))


def test_histogram_bars_are_shares_of_the_finite_draws():
    values, before = np.r_[np.linspace(0.0, 1.0, 30), np.nan], np.linspace(0.5, 3.0, 80)
    ax = drawn(charts.histogram(values, "gap, mm", (None, 2.0), before=before))
    after, outline = (patch.get_data() for patch in steps(ax))
    assert after.values.sum() == pytest.approx(100.0)
    assert outline.values.sum() == pytest.approx(100.0)
    assert after.edges == pytest.approx(outline.edges)
    inside = (values >= after.edges[2]) & (values < after.edges[3])
    assert after.values[2] == pytest.approx(100.0 * inside.sum() / 30)
    assert [patch.get_fill() for patch in steps(ax)] == [True, False]


def test_a_single_value_stands_in_the_middle_of_its_bar():
    data = steps(charts.histogram(np.array([0.41]), "arrival, s", (None, None)))[0].get_data()
    k = int(np.argmax(data.values))
    assert data.values[k] == 100.0
    assert 0.5 * (data.edges[k] + data.edges[k + 1]) == pytest.approx(0.41)


def test_values_that_differ_by_rounding_share_one_visible_bar():
    ax = drawn(charts.histogram(np.array([1e9, np.nextafter(1e9, 2e9)]), "gap, mm", (None, None)))
    data = steps(ax)[0].get_data()
    k = int(np.argmax(data.values))
    assert data.values[k] == 100.0
    assert data.edges[k + 1] - data.edges[k] > 0.02 * np.ptp(ax.get_xlim())


def test_distribution_steps_and_its_exact_band():
    ax = drawn(charts.distribution(np.array([3.0, 1.0, 2.0, 2.0, np.nan]), "gap, mm", (None, 5.0)))
    left, right = ax.get_xlim()
    assert places(ax, "draws") == pytest.approx([left, 1.0, 2.0, 3.0, right])
    assert np.asarray(line(ax, "draws").get_ydata()) == pytest.approx([0.0, 25.0, 75.0, 100.0, 100.0])
    band = ax.collections[0].get_paths()[0].vertices
    assert band is not None
    for place, failures in ((left, 0), (1.0, 1), (2.0, 3), (3.0, 4)):
        exact = binomtest(failures, 4).proportion_ci(0.95, method="exact")
        heights = np.unique(np.asarray(band)[np.isclose(np.asarray(band)[:, 0], place), 1])
        for end in (100.0 * exact.low, 100.0 * exact.high):
            assert np.min(np.abs(heights - end)) < 1e-9
    assert "95 % confidence" in legend(ax)


def test_convergence_is_in_percent_over_a_logarithmic_axis():
    counts, value = np.array([1, 10, 100, 1000]), np.array([0.0, 0.1, 0.02, 0.013])
    low, high = 0.5 * value, 0.03 + 0.9 / counts
    ax = drawn(charts.convergence(counts, value, low, high))
    assert ax.get_xscale() == "log"
    assert places(ax, "share that fails") == pytest.approx(counts)
    assert np.asarray(line(ax, "share that fails").get_ydata()) == pytest.approx(100.0 * value)
    band = np.asarray(ax.collections[0].get_paths()[0].vertices)
    for x, *ends in zip(counts, 100.0 * low, 100.0 * high, strict=True):
        at = np.unique(band[np.isclose(band[:, 0], x), 1])
        assert (at.min(), at.max()) == pytest.approx(ends)
    assert notes(ax) == "1.3 % (0.65 to 3.09 %) after 1000 draws"
    assert ax.get_ylim()[1] == pytest.approx(4.0 * 3.09)
    assert ax.get_ylim()[0] < 0.0, "a share of zero shows above the axis"
    assert "100" in [text.get_text() for text in ax.get_xticklabels()]


@pytest.mark.parametrize(
    ("counts", "value"),
    [([1], [0.0]), ([5], [1.0]), ([1, 2, 3], [np.nan] * 3), ([1, 7, 40], [0.0, 0.0, 0.0]), ([], [])],
)
def test_convergence_draws_whatever_the_values(counts, value):
    ax = drawn(charts.convergence(np.array(counts), np.array(value), np.array(value), np.array(value)))
    assert notes(ax).endswith(f"after {counts[-1]} draws" if np.isfinite(value).any() else "no finite value")


def test_contributions_come_largest_first_in_percent():
    intervals = {"Sobol total": (SHARES["Sobol total"] - 0.05, SHARES["Sobol total"] + 0.1)}
    ax = drawn(charts.contributions(NAMES, SHARES, intervals))
    assert rows(ax) == ["medium.grammage", "nip.preload", "feed.friction", "guide.end"]
    first, second = bars(ax)
    assert first == pytest.approx([50.0, 30.0, 10.0, 5.0])
    assert second == pytest.approx([45.0, 25.0, 20.0, np.nan], nan_ok=True)
    found = strokes(ax)
    assert found[:3, :2] == pytest.approx(np.array([[40.0, 55.0], [20.0, 35.0], [15.0, 30.0]]))
    middles = [bar.get_y() + 0.5 * bar.get_height() for bar in ax.containers[1]]
    assert found[:3, 2] == pytest.approx(middles[:3])
    assert set(legend(ax)) == {"gradient", "Sobol total", "interval"}
    assert ax.yaxis_inverted()


def test_a_share_of_hardly_anything_does_not_fill_the_axis():
    ax = drawn(charts.contributions(NAMES, {"gradient": np.full(len(NAMES), 1e-3)}))
    assert ax.get_xlim() == (0.0, 100.0)


def test_contributions_of_one_row_stay_within_it():
    ax = drawn(charts.contributions(NAMES, SHARES))
    spans = [(bar.get_y(), bar.get_y() + bar.get_height()) for held in ax.containers for bar in held]
    for k, (start, end) in enumerate(spans):
        assert k % 4 - 0.41 < start < end < k % 4 + 0.41
    colors = {tuple(bar.get_facecolor()[:3]) for held in ax.containers for bar in held}
    assert len(colors) == 2


@pytest.mark.parametrize("draw", ["contributions", "gains"])
class TestBars:
    def make(self, draw: str, names: list[str], **given):
        share = np.linspace(1.0, 0.1, len(names))
        if draw == "contributions":
            return charts.contributions(names, {"gradient": share}, {"gradient": (share, share)}, **given)
        return charts.gains(names, 0.1 * share, 0.01 * share, 0.1, **given)

    def test_one_name(self, draw):
        assert rows(drawn(self.make(draw, ["feed"]))) == ["feed"]

    def test_forty_names_are_cut(self, draw):
        names = [f"part {i}" for i in range(40)]
        assert rows(drawn(self.make(draw, names))) == [*names[:15], "and 25 smaller ones"]
        assert rows(drawn(self.make(draw, names, most=40))) == names
        assert len(bars(self.make(draw, names, most=3))[0]) == 3

    def test_long_names_fit(self, draw):
        names = ["outer guide of the turn, radius of its arc, mm", "word " * 50 + "end", "x" * 200 + "end", "nip"]
        ax = drawn(self.make(draw, names))
        figure = ax.figure
        assert figure is not None
        found = [text.get_window_extent() for text in ax.get_yticklabels()]
        assert all(box.x0 > 0.0 for box in found)
        assert ax.get_window_extent().width > 0.5 * figure.bbox.width
        assert all(upper.y0 >= lower.y1 for upper, lower in pairwise(found)), "names overlap"
        written = rows(ax)
        assert written[0].split("\n") == ["outer guide of the turn, radius of", "its arc, mm"]
        assert all(text.endswith("end") and "…" in text for text in written[1:3])
        assert written[3] == "nip"

    def test_what_is_not_finite_comes_last_and_breaks_nothing(self, draw):
        values = np.array([np.nan, 0.1, 0.2])
        names = ["a", "b", "c"]
        if draw == "contributions":
            ax = charts.contributions(names, {"gradient": values})
            charts.contributions(names, {"gradient": np.full(3, np.nan)})
        else:
            ax = charts.gains(names, values, values, 0.1)
            drawn(charts.gains(names, np.full(3, np.nan), np.full(3, np.nan), 0.1))
        assert rows(drawn(ax)) == ["c", "b", "a"]


def test_gains_are_percentage_points():
    ax = drawn(charts.gains(NAMES, np.array([0.02, -0.05, 0.0, 0.08]), np.array([0.01, 0.02, 0.0, 0.03]), 0.1))
    assert rows(ax) == ["nip.preload", "medium.grammage", "feed.friction", "guide.end"]
    better, worse = bars(ax)
    assert better == pytest.approx([8.0, 2.0, 0.0])
    assert worse == pytest.approx([-5.0])
    assert strokes(ax)[:, :2] == pytest.approx(np.array([[5.0, 11.0], [-7.0, -3.0], [1.0, 3.0], [0.0, 0.0]]))
    assert strokes(ax)[:, 2] == pytest.approx([0, 1, 2, 3])
    assert set(legend(ax)) == {"more draws pass", "fewer draws pass", "± standard error"}


def test_gains_name_only_the_changes_there_are():
    ax = drawn(charts.gains(NAMES[:2], np.array([0.02, 0.05]), np.array([0.01, 0.02]), 0.1))
    assert set(legend(ax)) == {"more draws pass", "± standard error"}


def test_latitude_colours_what_passes_and_hatches_what_failed():
    ax = drawn(charts.latitude(X, Y, MARGIN, MARGIN > 0.0, "grammage, g/m²", "friction", nominal=(80.0, 0.9)))
    mesh: Any = next(held for held in ax.collections if isinstance(held, QuadMesh))
    colors = np.reshape(mesh.get_facecolor(), (2, 3, 4))
    assert colors[0, 0] == pytest.approx(to_rgba(charts.PASSES_NOT))
    assert colors[0, 1] == pytest.approx(to_rgba(charts.PASSES))
    assert colors[1, 2] == pytest.approx(to_rgba(charts.FAILED))
    assert np.asarray(mesh.get_coordinates())[0, :, 0] == pytest.approx([50.0, 70.0, 100.0, 140.0])
    assert np.asarray(mesh.get_coordinates())[:, 0, 1] == pytest.approx([0.7, 0.9, 1.1])
    (hatched,) = (patch for patch in ax.patches if isinstance(patch, Rectangle) and patch.get_hatch())
    assert (*hatched.get_xy(), hatched.get_width(), hatched.get_height()) == pytest.approx((100.0, 0.9, 40.0, 0.2))
    assert (places(ax, "nominal").item(), np.asarray(line(ax, "nominal").get_ydata()).item()) == (80.0, 0.9)
    assert set(legend(ax)) == {"passes", "does not pass", "run failed", "margin (thick: 0)", "nominal"}


def test_latitude_writes_the_margin_on_its_contours_and_zero_is_thick():
    x, y = np.linspace(0.0, 1.0, 9), np.linspace(0.0, 1.0, 7)
    margin = np.tile(4.0 * x - 1.0, (7, 1))
    ax = drawn(charts.latitude(x, y, margin, margin > 0.0, "x", "y"))
    drawing: Any = next(held for held in ax.collections if isinstance(held, ContourSet))
    assert list(drawing.levels) == sorted(drawing.levels)
    widths = dict(zip(np.round(drawing.levels, 9), np.ravel(drawing.get_linewidths()), strict=True))
    assert widths.pop(0.0) > 2.0 * max(widths.values())
    zero = np.asarray(drawing.get_paths()[list(drawing.levels).index(0.0)].vertices)
    assert zero[:, 0] == pytest.approx(0.25)
    assert {"0", "1", "2"} <= {text.get_text() for text in drawing.labelTexts}
    assert legend(ax) == ["passes", "does not pass", "margin (thick: 0)"]


@pytest.mark.parametrize("place", [0.0, 80.0, -3.0])
def test_latitude_of_one_run_is_one_cell_around_it(place):
    ax = drawn(charts.latitude(np.array([place]), np.array([place]), np.ones((1, 1)), np.ones((1, 1), bool), "x", "y"))
    mesh: Any = next(held for held in ax.collections if isinstance(held, QuadMesh))
    corners = np.asarray(mesh.get_coordinates())
    assert np.all(corners[0, 0] < place)
    assert np.all(corners[1, 1] > place)


@pytest.mark.parametrize("shape", [(1, 1), (1, 4), (4, 1), (3, 3)])
@pytest.mark.parametrize("value", [0.0, 0.7, -1e-12, np.nan, np.inf])
def test_latitude_draws_whatever_the_values(shape, value):
    y, x = (np.arange(float(n)) for n in shape)
    margin = np.full(shape, value)
    ax = drawn(charts.latitude(x, y, margin, margin > 0.0, "x", "y", nominal=(9.0, 9.0)))
    assert ("run failed" in legend(ax)) == (not np.isfinite(value))
    assert not any("margin" in text for text in legend(ax))
    assert ax.get_xlim()[1] > 9.0
    margin[0, 0] = 1.0
    drawn(charts.latitude(x, y, margin, margin > 0.0, "x", "y"))
