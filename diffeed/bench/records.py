"""What a benchmark hands back: rows of plain data, which a file holds and gives back as they were."""

from dataclasses import asdict, dataclass, field
from typing import Any

from diffeed.bench.settings import Setting

FORMAT = 1


class BenchError(Exception):
    """A benchmark that cannot be run or read; the text says why."""


@dataclass(frozen=True)
class Row:
    """One setting: its cost and its errors, or why there are none."""

    setting: Setting
    status: str  # "ok", "failed" (the run), "not run"
    reason: str = ""
    compile_seconds: float | None = None
    run_seconds: float | None = None
    repeats: int = 0
    steps: int | None = None
    errors: dict[str, float | None] = field(default_factory=dict)  # by measure, against the reference
    where: dict[str, str] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        return self.status == "ok"

    def cost(self, duration: float) -> float | None:
        """Seconds per simulated second, without compiling."""
        return None if self.run_seconds is None else self.run_seconds / duration

    def microseconds(self) -> float | None:
        """Per step."""
        return None if self.run_seconds is None or not self.steps else 1e6 * self.run_seconds / self.steps


@dataclass(frozen=True)
class Reference:
    """The run that all others are compared with; `uncertainty` is its difference from a run at twice the step."""

    setting: Setting
    run_seconds: float
    uncertainty: dict[str, float | None]
    where: dict[str, str]


@dataclass(frozen=True)
class Front:
    """A sweep over the settings of one scene."""

    scene: str  # as the user named it
    key: str  # of the scene's text, duration included
    duration: float
    assignments: tuple[str, ...]
    rows: list[Row]
    reference: Reference | None
    no_reference: str  # why there is none
    machine: dict[str, Any]

    def plain(self) -> dict[str, Any]:
        """Types that JSON takes."""
        return {"format": FORMAT, **asdict(self)}


def read_front(data: Any) -> Front:
    """The benchmark that `Front.plain` wrote."""
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise BenchError(f"a benchmark of format {FORMAT} is needed")
    try:
        given = data["reference"]
        reference = None if given is None else Reference(**{**given, "setting": _setting(given["setting"])})
        rows = [Row(**{**row, "setting": _setting(row["setting"])}) for row in data["rows"]]
        rest = {k: v for k, v in data.items() if k not in ("format", "rows", "reference", "assignments")}
        return Front(**rest, rows=rows, reference=reference, assignments=tuple(data["assignments"]))
    except (KeyError, TypeError, AttributeError) as error:
        raise BenchError(f"a benchmark's file is not as it was written: {error}") from error


def _setting(data: dict[str, Any]) -> Setting:
    return Setting(**{**data, "changes": tuple(data["changes"])})
