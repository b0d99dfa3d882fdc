"""What a STUDY file says: which numbers may move, what is wanted, what must hold, how to search. Words and numbers only.

The records are checked by pydantic; what they mean for a scene is checked by `optimize.problem`.
"""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from optimize.records import Limit as Limit
from optimize.records import Measured as Measured
from optimize.records import Moved as Moved
from optimize.records import Name, Nonnegative, Number, Pair, Positive, Record, Runs, Seed, plain
from optimize.tolerance.records import Tolerance

Iterations = Annotated[int, Field(ge=1, le=1_000_000), plain]


class Variable(Moved):
    """One number that the search may change."""

    bounds: Pair
    """Lower and upper value, in the variable's own unit."""
    start: Number | None = None
    """Where the search begins; the scene's value if not given, no movement for a shift, a turn or a delay."""
    transform: Literal["bounded", "log"] = "bounded"
    """With "log", equal steps are equal shares; needs bounds > 0."""
    tolerance: Positive | None = None
    """Step that a designer would make, for checks and expected gradients; 1 % of the range if not given."""

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

    weight: Number = 1.0
    """Factor of this term; a negative one asks for more of the measure."""
    target: Number | None = None
    """Value to come near to; without it, less is better."""
    scale: Positive = 1.0
    """Size that counts as one, in the unit of the measure."""


class Medium(Record):
    """Another sheet through the same machine: numbers of the scene by path."""

    set: dict[str, Any] = Field(default_factory=dict)
    """Numbers and words of the scene by path."""
    weight: Positive = 1.0
    """Share of this medium in the mean over media."""


class Stage(Record):
    """A part of the search with easier settings: rounder corners (`smoothing`), another run length."""

    iterations: Iterations
    """Iterations of this stage."""
    smoothing: Annotated[float, Field(ge=1), plain] = 1.0
    """Smoothing lengths, stick speeds and stick displacements times this."""
    duration: Positive | None = None
    """s: length of its runs; the study's if not given."""


class Robust(Record):
    """How a search sees tolerances: `samples` machines with their own deviations at every point, and of their objectives
    (and of the shares by which limits are broken) the mean, the mean of the worst `tail` (CVaR), or the worst.

    The same deviations in every iteration, or with `redraw` new ones.
    """

    samples: Annotated[int, Field(ge=1, le=1024), plain] = 16
    """Machines at every point."""
    over: Literal["mean", "worst", "cvar"] = "mean"
    """What is made of their objectives."""
    tail: Annotated[float, Field(gt=0, le=1), plain] = 0.25
    """Share of machines that count as the worst, for cvar."""
    redraw: bool = False
    """New deviations in every iteration."""
    seed: Seed = 0
    """Of the deviations."""


class Search(Record):
    """How to search. `name`: an optimiser of optax; a step of the unit variables is about `learning_rate` long."""

    name: str = "adam"
    """An optimiser of optax, or lbfgs."""
    learning_rate: Positive = 0.05
    """Length of a step, in shares of the variables' ranges."""
    schedule: Literal["constant", "cosine", "exponential"] = "constant"
    """How the learning rate falls over the iterations of a stage."""
    clip: Positive | None = None
    """Longest gradient that is let through, in the objective per range."""
    iterations: Iterations = 60
    """Iterations, where no stages are given."""
    starts: Annotated[int, Field(ge=1, le=256), plain] = 1
    """Searches from as many points: the study's own start, the others spread about it."""
    spread: Annotated[float, Field(gt=0, le=1), plain] = 0.25
    """How far other starts lie from the first, in shares of the range."""
    seed: Seed = 0
    """Of starts and samples."""
    gradient: Literal["exact", "expected"] = "exact"
    """With "expected", the mean over points within the tolerances is followed (not by lbfgs)."""
    samples: Annotated[int, Field(ge=2, le=1024), plain] = 8
    """Points of an expected gradient."""
    patience: Iterations = 15
    """Iterations without a gain after which the search stops."""
    gain: Nonnegative = 1e-3
    """Share of the objective that counts as a gain."""
    goal: Number | None = None
    """Objective at which the search stops."""
    seconds: Positive | None = None
    """Time after which the search stops."""
    penalty: Positive = 10.0
    """First weight of broken limits; it grows as needed."""
    stages: Annotated[list[Stage], Field(max_length=100)] = Field(default_factory=list)
    """Parts of the search, one after the other, with easier settings."""


class Study(Runs):
    """A scene, what may change, what is wanted, what must hold, and how to search."""

    variables: Annotated[dict[Name, Variable], Field(min_length=1)]
    """What may change, by name."""
    objective: Annotated[dict[Name, Goal], Field(min_length=1)]
    """Terms of the objective by name; their sum is minimised."""
    limits: dict[Name, Limit] = Field(default_factory=dict)
    """What must hold, by name."""
    media: dict[Name, Medium] = Field(default_factory=dict)
    """Other sheets through the same machine, by name."""
    over: Literal["mean", "worst", "cvar"] = "mean"
    """What is made of the objectives of several media."""
    tail: Annotated[float, Field(gt=0, le=1), plain] = 0.5
    """Share of the media that count as the worst, for cvar."""
    tolerances: dict[Name, Tolerance] = Field(default_factory=dict)
    """How numbers scatter, by name: the search then looks at several machines at every point."""
    robust: Robust = Robust()
    """How the search sees tolerances."""
    search: Search = Search()
    """How to search."""
