"""What a STUDY file says: which numbers may move, what is wanted, what must hold, how to search. Words and numbers only.

The records are checked by pydantic; what they mean for a scene is checked by `optimize.problem`.
"""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Positive = Annotated[float, Field(gt=0)]
Nonnegative = Annotated[float, Field(ge=0)]
Pair = tuple[float, float]


class Record(BaseModel):
    """Unknown keys are errors, infinities and NaN are errors, nothing changes after it was read."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=False)


class Moved(Record):
    """What one number moves: exactly one of `path`, `shift` and `turn` is given.

    `path`: a number of the scene, or several that share one value (two rollers, one radius). `shift`: parts that move
    together along `direction`, in mm from where they are drawn. `turn`: parts that turn together about `about`, in degrees.
    """

    path: str | list[str] | None = None
    shift: list[str] | None = None
    turn: list[str] | None = None
    direction: Pair | None = None
    about: Pair | None = None
    meanings: ClassVar[tuple[str, ...]] = ("path", "shift", "turn")

    @model_validator(mode="after")
    def _one_meaning(self) -> "Moved":
        given = [name for name in self.meanings if getattr(self, name)]
        if len(given) != 1:
            raise ValueError(f"exactly one of {', '.join(self.meanings)} must be given, but {len(given)} are")
        if (self.direction is not None) != (given == ["shift"]):
            raise ValueError("direction belongs to shift, and only there")
        if (self.about is not None) != (given == ["turn"]):
            raise ValueError("about (the point) belongs to turn, and only there")
        return self

    @property
    def paths(self) -> list[str]:
        """The paths, if that is what it moves."""
        return [self.path] if isinstance(self.path, str) else list(self.path or ())


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


class Measured(Record):
    """A measure of a run: of which parts, and at which sensor."""

    measure: str
    of: str | list[str] | None = None
    at: str | None = None


class Goal(Measured):
    """One term of the objective: weight * ((measure - target)/scale)^2 with a target, weight * measure/scale without."""

    weight: float = 1.0
    target: float | None = None
    scale: Positive = 1.0


class Limit(Measured):
    """An inequality constraint on a measure. `scale` is the size of a violation that matters."""

    at_least: float | None = None
    at_most: float | None = None
    scale: Positive = 1.0

    @model_validator(mode="after")
    def _a_limit(self) -> "Limit":
        if self.at_least is None and self.at_most is None:
            raise ValueError("at_least or at_most must be given")
        if self.at_least is not None and self.at_most is not None and not self.at_least < self.at_most:
            raise ValueError(f"at_least must be below at_most, but {self.at_least:g} and {self.at_most:g} are given")
        return self


class Medium(Record):
    """Another sheet through the same machine: numbers of the scene by path."""

    set: dict[str, Any] = {}
    weight: Positive = 1.0


class Stage(Record):
    """A part of the search with easier settings: smoothing and stick speed times `smoothing`, another run length."""

    iterations: Annotated[int, Field(ge=1)]
    smoothing: Annotated[float, Field(ge=1)] = 1.0
    duration: Positive | None = None


class Search(Record):
    """How to search. `name`: an optimiser of optax; a step of the unit variables is about `learning_rate` long."""

    name: str = "adam"
    learning_rate: Positive = 0.05
    schedule: Literal["constant", "cosine", "exponential"] = "constant"
    clip: Positive | None = None
    iterations: Annotated[int, Field(ge=1)] = 60
    starts: Annotated[int, Field(ge=1, le=256)] = 1
    spread: Annotated[float, Field(gt=0, le=1)] = 0.25
    seed: Annotated[int, Field(ge=0)] = 0
    gradient: Literal["exact", "expected"] = "exact"
    samples: Annotated[int, Field(ge=2, le=1024)] = 8
    patience: Annotated[int, Field(ge=1)] = 15
    gain: Nonnegative = 1e-3
    goal: float | None = None
    seconds: Positive | None = None
    penalty: Positive = 10.0
    stages: list[Stage] = []


class Study(Record):
    """A scene, what may change, what is wanted, what must hold, and how to search."""

    scene: str
    duration: Positive | None = None
    dt: Positive = 5e-4
    frames: Annotated[int, Field(ge=2, le=100_001)] = 41
    method: str = "linear_euler"
    set: dict[str, Any] = {}
    variables: Annotated[dict[str, Variable], Field(min_length=1)]
    objective: Annotated[dict[str, Goal], Field(min_length=1)]
    limits: dict[str, Limit] = {}
    media: dict[str, Medium] = {}
    over: Literal["mean", "worst", "cvar"] = "mean"
    tail: Annotated[float, Field(gt=0, le=1)] = 0.5
    search: Search = Search()
    title: str = ""
