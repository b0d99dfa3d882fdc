"""The benchmarks other than the front, as a terminal and a picture show them: by name, from the data that their files hold."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from diffeed.bench import charts, report, stability_chart

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from rich.console import Console


class Kind(NamedTuple):
    """How one benchmark is shown."""

    print: Callable[["Console", dict[str, Any]], None]
    draw: Callable[[dict[str, Any]], "Axes"]


KINDS = {
    "batch": Kind(
        lambda console, data: report.print_batch(console, data["rows"]),
        lambda data: charts.batch(data["rows"], data["machine"]["device"]),
    ),
    "features": Kind(
        lambda console, data: report.print_features(console, data["rows"], data["values_not_kinds"]),
        lambda data: charts.features(data["rows"]),
    ),
    "gradient": Kind(
        lambda console, data: report.print_gradient(console, data["rows"]), lambda data: charts.gradient(data["rows"])
    ),
    "growth": Kind(
        lambda console, data: report.print_growth(console, data["rows"], data["exponents"]),
        lambda data: charts.growth(data["rows"]),
    ),
    "ripple": Kind(
        lambda console, data: report.print_ripple(console, data["rows"]), lambda data: charts.ripple(data["rows"])
    ),
    "roughness": Kind(
        lambda console, data: report.print_roughness(console, data), lambda data: charts.roughness(data["rows"])
    ),
    "stability": Kind(
        lambda console, data: report.print_stability(console, data["rows"]),
        lambda data: stability_chart.stability(data["rows"]),
    ),
}
