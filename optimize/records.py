"""What studies of all kinds are made of: a record that knows its fields, what a number moves, a measure, a limit."""

from collections.abc import Iterable
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from diffeed.base.limits import MAX_STEPS
from diffeed.base.words import escaped, name_problem
from diffeed.readings.agreement import finer


def _named(name: str) -> str:
    if problem := name_problem(name):
        raise ValueError(problem)
    return name


def _one_line(text: str) -> str:
    if escaped(text) != text:
        raise ValueError("must be one line without control characters")
    return text


def _no_word(value: Any) -> Any:
    """Left to itself, pydantic reads "5" as 5 and true as 1."""
    if isinstance(value, (str, bytes, bool, np.bool_)):
        raise PydanticCustomError("number", "Input should be a number")
    return value


plain = BeforeValidator(_no_word)
"""After a `Field`, so that the schema knows its bounds."""
Number = Annotated[float, plain]
Name = Annotated[str, AfterValidator(_named)]
"""Of a variable, a limit, a measure: it appears in pictures and in the names of files."""
Title = Annotated[str, Field(max_length=200), AfterValidator(_one_line)]
Seed = Annotated[int, Field(ge=0, le=2**32 - 1), plain]
Positive = Annotated[float, Field(gt=0), plain]
Nonnegative = Annotated[float, Field(ge=0), plain]
Pair = tuple[Number, Number]


class Record(BaseModel):
    """Unknown keys are errors, infinities and NaN are errors, nothing changes after it was read.

    The text below a field is its description in the schema and in the documentation."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, strict=False, use_attribute_docstrings=True
    )


class Moved(Record):
    """What one number moves: exactly one of `path`, `shift`, `turn` and `delay` is given.

    `path`: a number of the scene, or several that share one value (two rollers, one radius). `shift`: parts that move
    together along `direction`, in mm from where they are drawn. `turn`: parts that turn together about `about`, in degrees.
    `delay`: times that come later together, in s after what is written.
    """

    path: str | list[str] | None = None
    """A number of the scene by its path, or several that share one value."""
    shift: list[str] | None = None
    """Rollers or guides ("guides.turn") that move together along `direction`, mm from where they are drawn."""
    turn: list[str] | None = None
    """Rollers or guides that turn together about `about`, degrees."""
    delay: list[str] | None = None
    """Times ("guides.gate.motion.times", all of it, or "rollers.drive.surface_speed.times[2]") that come later together, s."""
    direction: Pair | None = None
    """Of a shift; its length does not count."""
    about: Pair | None = None
    """mm: the point of a turn."""
    meanings: ClassVar[tuple[str, ...]] = ("path", "shift", "turn", "delay")

    @model_validator(mode="after")
    def _named_once(self) -> "Moved":
        for moved in (self.paths, self.shift or [], self.turn or [], self.delay or []):
            if twice := sorted({name for name in moved if moved.count(name) > 1}):
                raise ValueError(f"each number or part must be named once, but {', '.join(twice)} is named again")
        return self

    @model_validator(mode="after")
    def _one_meaning(self) -> "Moved":
        given = [name for name in self.meanings if getattr(self, name)]
        if len(given) != 1:
            raise ValueError(f"exactly one of {', '.join(self.meanings)} must be given, but {len(given)} are")
        if (self.direction is not None) != (given == ["shift"]):
            raise ValueError(
                "a shift needs its direction"
                if self.direction is None
                else "direction belongs to shift, and only there"
            )
        if self.direction is not None and not any(self.direction):
            raise ValueError("direction must not be zero")
        if (self.about is not None) != (given == ["turn"]):
            raise ValueError("about (the point) belongs to turn, and only there")
        return self

    @property
    def paths(self) -> list[str]:
        """The paths, if that is what it moves."""
        return [self.path] if isinstance(self.path, str) else list(self.path or ())


class Runs(Record):
    """The scene of a study and how it is run. `set`: numbers of the scene by path.

    With a `step_tolerance` (mm) steps are chosen by their error, none longer than `dt` if that is given.
    """

    scene: str
    """Name of a shipped scene, or path of a scene file; a relative one counts from the study file."""
    duration: Positive | None = None
    """s: length of a run; the scene's own if not given."""
    dt: Positive = 1e-4
    """s: longest step; that of `diffeed run` unless given."""
    step_tolerance: Positive | None = None
    """mm: choose steps by their error, none longer than `dt` if that is given."""
    most_steps: Annotated[int, Field(ge=1, le=MAX_STEPS), plain] = 20_000
    """With a `step_tolerance`: steps of one run; memory of a reverse-mode gradient grows with it."""
    frames: Annotated[int, Field(ge=2, le=100_001), plain] = 41
    """Moments of a run that are looked at, evenly spaced."""
    method: str = "linear_euler"
    """Time stepper."""
    set: dict[str, Any] = Field(default_factory=dict)
    """Numbers and words of the scene by path, changed before anything else."""
    title: Title = ""
    """For pictures and tables."""

    @model_validator(mode="after")
    def _a_step_for_each_frame(self) -> "Runs":
        least = self.frames - 1
        if self.step_tolerance is not None and self.most_steps < least:
            raise ValueError(
                f"most_steps must be at least one for each frame after the first ({least}) with a step_tolerance, "
                f"but is {self.most_steps}"
            )
        return self

    def as_run(self, left_out: Iterable[str]) -> dict[str, Any]:
        """Its values, with how it really steps: with a `step_tolerance` a `dt` that is not given is no bound, whatever its
        default says."""
        return self.model_dump(mode="json", exclude=set(left_out)) | self.stepping

    @property
    def stepping(self) -> dict[str, Any]:
        """How `diffeed.simulate` is to step."""
        if self.step_tolerance is None:
            return {"dt": self.dt, "method": self.method}
        dt = self.dt if "dt" in self.model_fields_set else None
        return {"dt": dt, "method": self.method, "tolerance": self.step_tolerance, "most_steps": self.most_steps}

    def finer(self) -> Self:
        """The same with steps `diffeed.readings.agreement.FINER` times shorter, or such a tolerance and as many more steps."""
        steps = finer(self.dt, self.step_tolerance, self.most_steps)
        return self.model_copy(update={"step_tolerance" if key == "tolerance" else key: v for key, v in steps.items()})


class Measured(Record):
    """A measure of a run: of which parts, and at which sensor."""

    measure: str
    """What is measured of a run."""
    of: str | list[str] | None = None
    """Roller or sheet, or several: their mean; the first sheet if a measure of sheets names none."""
    at: str | None = None
    """Sensor, for arrivals."""


class Limit(Measured):
    """An inequality constraint on a measure. `scale` is the size of a violation that matters."""

    at_least: Number | None = None
    """Smallest value that is allowed, in the unit of the measure."""
    at_most: Number | None = None
    """Largest value that is allowed."""
    scale: Positive = 1.0
    """Size of a violation that matters, in the unit of the measure."""

    @model_validator(mode="after")
    def _a_limit(self) -> "Limit":
        if self.at_least is None and self.at_most is None:
            raise ValueError("at_least or at_most must be given")
        if self.at_least is not None and self.at_most is not None and not self.at_least < self.at_most:
            raise ValueError(f"at_least must be below at_most, but {self.at_least:g} and {self.at_most:g} are given")
        return self
