"""What a STUDY file says: which numbers may move, what is wanted, what must hold, how to search. Words and numbers only.

The records are checked by pydantic; what they mean for a scene is checked by `optimize.problem`.
"""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from optimize.records import Limit as Limit
from optimize.records import Measured as Measured
from optimize.records import Moved as Moved
from optimize.records import Name, Nonnegative, Pair, Positive, Record, Runs, Seed
from optimize.tolerance.records import Tolerance

Iterations = Annotated[int, Field(ge=1, le=1_000_000)]


class Variable(Moved):
    """One number that the search may change."""

    bounds: Pair
    start: float | None = None
    transform: Literal["bounded", "log"] = "bounded"
    tolerance: Positive | None = None

    @model_validator(mode="after")
    def _holds_its_start(self) -> "Variable":
        low, high = self.bounds
        if not low < high:
            raise ValueError(f"bounds must be [lower, upper] with lower < upper, but are {[low, high]}")
        if self.transform == "log" and low <= 0:
            raise ValueError(f"a log transform needs bounds > 0, but the lower bound is {low:g}")
        if self.start is not None and not low <= self.start <= high:
            raise ValueError(f"start must lie within bounds {[low, high]}, but is {self.start:g}")
        return self


class Goal(Measured):
    """One term of the objective: weight * ((measure - target)/scale)^2 with a target, weight * measure/scale without."""

    weight: float = 1.0
    target: float | None = None
    scale: Positive = 1.0


class Medium(Record):
    """Another sheet through the same machine: numbers of the scene by path."""

    set: dict[str, Any] = Field(default_factory=dict)
    weight: Positive = 1.0


class Stage(Record):
    """A part of the search with easier settings: smoothing and stick speed times `smoothing`, another run length."""

    iterations: Iterations
    smoothing: Annotated[float, Field(ge=1)] = 1.0
    duration: Positive | None = None


class Robust(Record):
    """How a search sees tolerances: `samples` machines with their own deviations at every point, and of their objectives
    (and of the shares by which limits are broken) the mean, the mean of the worst `tail` (CVaR), or the worst.

    The same deviations in every iteration, or with `redraw` new ones.
    """

    samples: Annotated[int, Field(ge=1, le=1024)] = 16
    over: Literal["mean", "worst", "cvar"] = "mean"
    tail: Annotated[float, Field(gt=0, le=1)] = 0.25
    redraw: bool = False
    seed: Seed = 0


class Search(Record):
    """How to search. `name`: an optimiser of optax; a step of the unit variables is about `learning_rate` long."""

    name: str = "adam"
    learning_rate: Positive = 0.05
    schedule: Literal["constant", "cosine", "exponential"] = "constant"
    clip: Positive | None = None
    iterations: Iterations = 60
    starts: Annotated[int, Field(ge=1, le=256)] = 1
    spread: Annotated[float, Field(gt=0, le=1)] = 0.25
    seed: Seed = 0
    gradient: Literal["exact", "expected"] = "exact"
    samples: Annotated[int, Field(ge=2, le=1024)] = 8
    patience: Iterations = 15
    gain: Nonnegative = 1e-3
    goal: float | None = None
    seconds: Positive | None = None
    penalty: Positive = 10.0
    stages: Annotated[list[Stage], Field(max_length=100)] = Field(default_factory=list)


class Study(Runs):
    """A scene, what may change, what is wanted, what must hold, and how to search."""

    variables: Annotated[dict[Name, Variable], Field(min_length=1)]
    objective: Annotated[dict[Name, Goal], Field(min_length=1)]
    limits: dict[Name, Limit] = Field(default_factory=dict)
    media: dict[Name, Medium] = Field(default_factory=dict)
    over: Literal["mean", "worst", "cvar"] = "mean"
    tail: Annotated[float, Field(gt=0, le=1)] = 0.5
    tolerances: dict[Name, Tolerance] = Field(default_factory=dict)
    robust: Robust = Robust()
    search: Search = Search()
