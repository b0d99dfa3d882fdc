"""What a TOLERANCE study says: which numbers scatter and how, what is measured, what must hold, how many samples."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from optimize.records import Limit, Measured, Moved, Name, Number, Pair, Positive, Record, Runs, Seed, plain


class Tolerance(Moved):
    """How one number, or each of several like ones, scatters about what the scene says.

    `path`, `shift`, `turn`, `delay` as for a design variable; `climate`: the climate of a sheet's media card, -1 dry to 1 humid.
    Several paths or parts are drawn independently of each other, unless `tied`. The size is `sigma`, or `tolerance`, a
    plus-minus that stands for `sigmas` standard deviations (for uniform and triangular: its half width). `relative`: in
    shares of the nominal value. `offset`: the mean is off by so much (wear). `limits`: deviations that inspection lets
    through (truncated_normal; the tolerance itself if not given). `group`: drawn with `correlation` among all of a group.
    `file` and `column`: measured values. `cost`: of making it 10 % tighter.
    """

    climate: str | None = None
    """Sheet whose media card moves with the climate, -1 dry to 1 humid; it needs a card in `media`."""
    kind: Literal["normal", "truncated_normal", "uniform", "triangular", "log_normal", "data"] = "normal"
    """Distribution."""
    tolerance: Positive | None = None
    """Plus-minus that stands for `sigmas` standard deviations; half the width if uniform or triangular."""
    sigmas: Positive = 3.0
    """Standard deviations in a `tolerance`."""
    sigma: Positive | None = None
    """Standard deviation, instead of a `tolerance`."""
    relative: bool = False
    """Sizes are shares of the nominal value."""
    offset: Number = 0.0
    """The mean is off the nominal value by so much (wear)."""
    limits: Pair | None = None
    """Deviations that inspection lets through (truncated_normal); the tolerance itself if not given."""
    tied: bool = False
    """Several paths or parts share one draw."""
    group: Name | None = None
    """Name of a group that is drawn together (one batch of rubber)."""
    correlation: Annotated[float, Field(ge=0, le=1), plain] = 0.8
    """Within the group."""
    file: str | None = None
    """CSV file of measured values (kind = "data"); a relative path counts from the study file."""
    column: str | None = None
    """Heading of the values in that file."""
    cost: Positive | None = None
    """Of making the tolerance 10 % tighter, in any unit."""
    meanings: ClassVar[tuple[str, ...]] = ("path", "shift", "turn", "delay", "climate")

    @model_validator(mode="after")
    def _one_size(self) -> "Tolerance":
        if self.limits is not None and self.kind != "truncated_normal":
            raise ValueError('limits belong to kind = "truncated_normal"')
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
        if self.limits is not None and not self.limits[0] < 0.0 < self.limits[1]:
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
    """A number of the scene by path, or several that share one value."""
    climate: str | None = None
    """Sheet whose media card moves with the climate."""
    range: Pair
    """Lower and upper value."""
    points: Annotated[int, Field(ge=2, le=201), plain] = 21
    """Values along the axis."""

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
    """Across."""
    y: Axis
    """Upwards."""


class ToleranceStudy(Runs):
    """A scene, how its numbers scatter, what is measured, what must hold, and how to sample."""

    media: dict[Name, str] = Field(default_factory=dict)
    """Media card of a sheet by its name: "copy_paper_80", or with a climate "copy_paper_80/humid"."""
    tolerances: Annotated[dict[Name, Tolerance], Field(min_length=1)]
    """How numbers scatter, by name."""
    measures: dict[Name, Measured] = Field(default_factory=dict)
    """What is recorded of each sample, by name."""
    limits: dict[Name, Limit] = Field(default_factory=dict)
    """What must hold for a sample to pass, by name; recorded as well."""
    samples: Annotated[int, Field(ge=1, le=10_000_000), plain] = 1000
    """Machines that are drawn."""
    sampling: Literal["plain", "latin_hypercube", "sobol"] = "plain"
    """How they are drawn."""
    seed: Seed = 0
    """Of the draws."""
    latitude: Latitude | None = None
    """A map over two quantities, for the command `latitude`."""

    @model_validator(mode="after")
    def _names_differ(self) -> "ToleranceStudy":
        both = sorted(set(self.measures) & set(self.limits))
        if both:
            raise ValueError(f"a measure and a limit share the name {', '.join(both)}")
        return self
