"""What a TOLERANCE study says: which numbers scatter and how, what is measured, what must hold, how many samples."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from optimize.records import Limit, Measured, Moved, Name, Pair, Positive, Record, Runs, Seed


class Tolerance(Moved):
    """How one number, or each of several like ones, scatters about what the scene says.

    `path`, `shift`, `turn` as for a design variable; `climate`: the climate of a sheet's media card, -1 dry to 1 humid.
    Several paths or parts are drawn independently of each other, unless `tied`. The size is `sigma`, or `tolerance`, a
    plus-minus that stands for `sigmas` standard deviations (for uniform and triangular: its half width). `relative`: in
    shares of the nominal value. `offset`: the mean is off by so much (wear). `limits`: deviations that inspection lets
    through (truncated_normal; the tolerance itself if not given). `group`: drawn with `correlation` among all of a group.
    `file` and `column`: measured values. `cost`: of making it 10 % tighter.
    """

    climate: str | None = None
    kind: Literal["normal", "truncated_normal", "uniform", "triangular", "log_normal", "data"] = "normal"
    tolerance: Positive | None = None
    sigmas: Positive = 3.0
    sigma: Positive | None = None
    relative: bool = False
    offset: float = 0.0
    limits: Pair | None = None
    tied: bool = False
    group: Name | None = None
    correlation: Annotated[float, Field(ge=0, le=1)] = 0.8
    file: str | None = None
    column: str | None = None
    cost: Positive | None = None
    meanings: ClassVar[tuple[str, ...]] = ("path", "shift", "turn", "climate")

    @model_validator(mode="after")
    def _one_size(self) -> "Tolerance":
        if self.kind == "data":
            if self.file is None or self.column is None:
                raise ValueError("data needs file (a CSV file) and column (its heading)")
            if self.path is None:
                raise ValueError("data are values of a number: they need path")
            if self.sigma is not None or self.tolerance is not None or self.relative or self.offset:
                raise ValueError("data have their own size: sigma, tolerance, relative and offset do not go with them")
            return self
        if (self.sigma is None) == (self.tolerance is None):
            raise ValueError("exactly one of tolerance and sigma must be given")
        if self.file is not None or self.column is not None:
            raise ValueError('file and column belong to kind = "data"')
        if self.limits is not None:
            if self.kind != "truncated_normal":
                raise ValueError('limits belong to kind = "truncated_normal"')
            if not self.limits[0] < 0.0 < self.limits[1]:
                raise ValueError(
                    f"limits are deviations and must hold the nominal value, 0, between them, but are {list(self.limits)}"
                )
        if self.kind == "truncated_normal" and self.limits is None and self.tolerance is None:
            raise ValueError("truncated_normal needs limits, or a tolerance to stand for them")
        if self.kind == "log_normal" and (self.relative or self.path is None):
            raise ValueError("log_normal is a share of a number already: it needs path, and no relative")
        if self.relative and self.path is None:
            raise ValueError("relative needs path: a share of a number")
        return self


class Axis(Record):
    """One side of a media latitude: numbers by path that share a value, or the climate of a sheet's card."""

    path: str | list[str] | None = None
    climate: str | None = None
    range: Pair
    points: Annotated[int, Field(ge=2, le=201)] = 21

    @model_validator(mode="after")
    def _one_meaning(self) -> "Axis":
        if bool(self.path) == bool(self.climate):
            raise ValueError("exactly one of path and climate must be given")
        if not self.range[0] < self.range[1]:
            raise ValueError(f"range must be [lower, upper] with lower < upper, but is {list(self.range)}")
        return self

    @property
    def paths(self) -> list[str]:
        return [self.path] if isinstance(self.path, str) else list(self.path or ())


class Latitude(Record):
    """Two quantities over which a map is drawn of what passes."""

    x: Axis
    y: Axis


class ToleranceStudy(Runs):
    """A scene, how its numbers scatter, what is measured, what must hold, and how to sample."""

    dt: Positive = 2e-4
    media: dict[Name, str] = Field(default_factory=dict)
    tolerances: Annotated[dict[Name, Tolerance], Field(min_length=1)]
    measures: dict[Name, Measured] = Field(default_factory=dict)
    limits: dict[Name, Limit] = Field(default_factory=dict)
    samples: Annotated[int, Field(ge=1, le=10_000_000)] = 1000
    sampling: Literal["plain", "latin_hypercube", "sobol"] = "plain"
    seed: Seed = 0
    latitude: Latitude | None = None

    @model_validator(mode="after")
    def _names_differ(self) -> "ToleranceStudy":
        both = sorted(set(self.measures) & set(self.limits))
        if both:
            raise ValueError(f"a measure and a limit share the name {', '.join(both)}")
        return self
