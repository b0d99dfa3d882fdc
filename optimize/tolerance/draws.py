"""From a study to numbers: its inputs (one per number that scatters), and what sample i draws for each of them.

Row i of `uniforms` belongs to sample i whatever the batch, chunk, device or process that runs it; `deviations` turns it
into what is added to the scene's own numbers. All on the host, by SciPy.
"""

import csv
import hashlib
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

import diffeed
from diffeed.base.names import hint
from optimize import variables as free
from optimize.asked import number_at
from optimize.records import Moved
from optimize.tolerance.media import CLIMATES, Card, MediaError, find
from optimize.tolerance.records import Tolerance

MAX_BYTES = 100_000_000
"""Of a table of measured values."""
MOST_INPUTS = 2_000
COUNTED = 2**13
"""Draws by which the correlation of deviations that are not normal is found."""
EDGE = 1e-12
"""Uniform numbers are kept this far from 0 and 1, whose normal deviates are infinite."""


class Input(NamedTuple):
    """One independent number that scatters."""

    name: str
    of: Tolerance
    what: Moved  # what this input alone moves
    unit: str  # of its deviation; "1" for a share
    column: np.ndarray | None  # sorted measured values, kind "data"
    nominal: float  # of a number by path; 0 for movements and climates
    climate: tuple[str, Card, float] | None  # sheet, card, the climate that the study starts from

    @property
    def share(self) -> bool:
        """Whether it is a share of the nominal value."""
        return self.of.relative or self.of.kind == "log_normal"

    @property
    def scale(self) -> float:
        """What a unit deviate is worth: a standard deviation, or half the width (uniform, triangular)."""
        of = self.of
        if of.kind == "data":
            return 1.0
        if of.kind in ("uniform", "triangular"):
            return of.tolerance or float(of.sigma or 0.0) * np.sqrt(3.0 if of.kind == "uniform" else 6.0)
        return of.sigma or float(of.tolerance or 0.0) / of.sigmas

    @property
    def sigma(self) -> float:
        """Standard deviation of the deviation, in its unit."""
        if self.column is not None:
            return float(np.std(self.column))
        return self.scale * float(_deviate(self).std())


def _cut(given: Input) -> tuple[float, float]:
    """Limits of a truncated normal, in standard deviations."""
    low, high = given.of.limits or (-(given.of.tolerance or 0.0), given.of.tolerance or 0.0)
    return low / given.scale, high / given.scale


def _deviate(given: Input) -> Any:
    """The distribution of the deviate, about 0: SciPy's, frozen."""
    if given.of.kind == "uniform":
        return stats.uniform(-1.0, 2.0)
    if given.of.kind == "triangular":
        return stats.triang(0.5, -1.0, 2.0)
    return stats.truncnorm(*_cut(given)) if given.of.kind == "truncated_normal" else stats.norm()


# --- inputs -------------------------------------------------------------------------------------------------------------


def cards_of(media: dict[str, str], scene: diffeed.Scene, problems: list[str]) -> dict[str, tuple[Card, float]]:
    """Card and climate by sheet; what does not fit is added to `problems`."""
    cards = {}
    for sheet, name in media.items():
        try:
            if sheet not in scene.sheets:
                raise MediaError(f'there is no sheet "{sheet}"{hint(sheet, scene.sheets)}')
            card, climate = find(name)
            cards[sheet] = (card, CLIMATES[climate])
        except MediaError as error:
            problems.append(f"media.{sheet}: {error}")
    return cards


def key_of(study: dict[str, Any], inputs: Sequence[Input], scenes: Sequence[diffeed.Scene]) -> str:
    """Equal for the same values in the same order (that of a point's numbers and of the draws), measured columns and scenes,
    wherever their files lie."""
    placeless = {name: tolerance | {"file": None} for name, tolerance in study["tolerances"].items()}
    columns = [i.column.tolist() for i in inputs if i.column is not None]
    text = json.dumps([study | {"tolerances": placeless}, columns, [diffeed.scene_text(s) for s in scenes]])
    return hashlib.sha256(text.encode()).hexdigest()


def inputs_of(
    tolerances: dict[str, Tolerance], cards: dict[str, tuple[Card, float]], scene: diffeed.Scene, folder: Path,
    problems: list[str],
) -> tuple[Input, ...]:  # fmt: skip
    """All inputs in the order of the tolerances; what does not fit is added to `problems`."""
    found = []
    problems += _climate_problems(tolerances)
    for name, of in tolerances.items():
        before = len(problems)
        column = _column(f"tolerances.{name}", of, folder, problems) if of.kind == "data" else None
        for part, what in _targets(of):
            label = name if part is None else f"{name}[{part}]"
            made = _input(label, of, what, column, scene, cards, problems)
            if made is not None and len(problems) == before:
                found.append(made)
        if len(found) > MOST_INPUTS:
            problems.append(f"tolerances must scatter at most {MOST_INPUTS} numbers, but {name} is beyond that")
            break
    return tuple(found)


def _climate_problems(tolerances: dict[str, Tolerance]) -> Iterator[str]:
    """A sheet has one climate: the second would replace the first."""
    first: dict[str, str] = {}
    for name, of in tolerances.items():
        if of.climate is not None and first.setdefault(of.climate, name) != name:
            said = f"must name another sheet than tolerances.{first[of.climate]}, but names {of.climate} again"
            yield f"tolerances.{name}.climate {said}"


def _targets(of: Tolerance) -> list[tuple[str | None, Moved]]:
    """What moves independently: each path or part by itself, unless tied."""
    meaning = next(name for name in of.meanings if getattr(of, name))
    several = of.paths or getattr(of, meaning)
    if meaning == "climate" or of.tied or len(several) == 1:
        return [(None, of)]
    single = [Moved(**{meaning: [one]}, direction=of.direction, about=of.about) for one in several]
    parts = [_part(p) for p in several]
    labels = parts if len(set(parts)) == len(parts) else several  # two numbers of one part: only whole paths differ
    return list(zip(labels, single, strict=True))


def _part(path: str) -> str:
    """rollers.drive_1.radius -> drive_1: what tells like parts apart."""
    names = path.split(".")
    return names[1] if len(names) > 1 else path


def _input(
    label: str, of: Tolerance, what: Moved, column: np.ndarray | None, scene: diffeed.Scene,
    cards: dict[str, tuple[Card, float]], problems: list[str],
) -> Input | None:  # fmt: skip
    where = f"tolerances.{label}"
    if of.climate is not None:
        if of.climate not in cards:
            problems.append(
                f'{where}.climate needs a card for sheet "{of.climate}": media.{of.climate} = "copy_paper_80", say'
            )
            return None
        card, base = cards[of.climate]
        return Input(label, of, what, "1", None, 0.0, (of.climate, card, base))
    try:
        free.refuse_moves(scene, what)
        values = [number_at(scene, p) for p in what.paths]
        unit = free.unit_text(scene, what)
    except ValueError as error:
        problems.append(f"{where}: {error}")
        return None
    nominal = values[0] if values else 0.0
    share = of.relative or of.kind == "log_normal"
    if share and nominal == 0.0:
        problems.append(f"{where}: a share of a number that is 0 is always 0; give the tolerance in {unit}")
    return Input(label, of, what, "1" if share else unit, column, nominal, None)


def _column(where: str, of: Tolerance, folder: Path, problems: list[str]) -> np.ndarray | None:
    path = folder / str(of.file)
    try:
        if not path.is_file() or path.stat().st_size > MAX_BYTES:  # a device has no end
            problems.append(f"{where}.file: {path} must be a file of at most {MAX_BYTES / 1e6:g} MB")
            return None
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = csv.DictReader(stream)
            known = rows.fieldnames or []
            if of.column not in known:
                problems.append(f'{where}.column: {path} has no column "{of.column}"{hint(of.column, known)}')
                return None
            values = np.array([_entry(row, str(of.column), rows.line_num) for row in rows])
    except (OSError, ValueError, TypeError, csv.Error) as error:
        problems.append(f"{where}.file: {path} cannot be read as a table of numbers: {error}")
        return None
    if len(values) < 2 or not np.isfinite(values).all():
        problems.append(f"{where}.file: {path} must hold at least two finite values, but holds {len(values)}")
        return None
    return np.sort(values)


def _entry(row: dict[Any, Any], column: str, line: int) -> float:
    if None in row:
        raise ValueError(f"line {line} has more entries than there are headings (decimal commas?)")
    return float(row[column])


# --- samples ------------------------------------------------------------------------------------------------------------


def groups(inputs: tuple[Input, ...]) -> list[str]:
    """Names of the groups that are drawn together; each takes one more uniform number."""
    return sorted({i.of.group for i in inputs if i.of.group})


def uniforms(inputs: tuple[Input, ...], sampling: str, samples: int, seed: int) -> np.ndarray:
    """(samples, inputs + groups) in (0, 1). Rows do not depend on how many there are, but for latin_hypercube."""
    d = len(inputs) + len(groups(inputs))
    if sampling == "sobol":
        drawn = stats.qmc.Sobol(d, rng=seed).random_base2(max(0, int(np.ceil(np.log2(samples)))))[:samples]
    elif sampling == "latin_hypercube":
        drawn = stats.qmc.LatinHypercube(d, rng=seed).random(samples)
    else:
        drawn = np.stack([_plain(seed, i, d) for i in range(samples)])
    return np.clip(drawn, EDGE, 1.0 - EDGE)


def _plain(seed: int, sample: int, d: int) -> np.ndarray:
    """Numbers of one sample from its own stream of a counter-based generator."""
    return np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, 0, sample])).random(d)


def deviates(inputs: tuple[Input, ...], u: np.ndarray) -> np.ndarray:
    """(samples, inputs + groups) -> (samples, inputs) uniform numbers, correlated within groups (a Gaussian copula)."""
    own = u[:, : len(inputs)].copy()
    shared = {name: stats.norm.ppf(u[:, len(inputs) + k]) for k, name in enumerate(groups(inputs))}
    for k, given in enumerate(inputs):
        if given.of.group:
            rho = given.of.correlation
            z = np.sqrt(rho) * shared[given.of.group] + np.sqrt(1.0 - rho) * stats.norm.ppf(own[:, k])
            own[:, k] = np.clip(stats.norm.cdf(z), EDGE, 1.0 - EDGE)
    return own


def correlation(inputs: tuple[Input, ...]) -> np.ndarray:
    """(inputs, inputs) of the normal numbers behind the inputs: within a group the root of both members' `correlation`."""
    loads = np.array([np.sqrt(i.of.correlation) if i.of.group else 0.0 for i in inputs])
    together = np.array([[a.of.group is not None and a.of.group == b.of.group for b in inputs] for a in inputs])
    found = np.where(together, np.outer(loads, loads), 0.0)
    np.fill_diagonal(found, 1.0)
    return found


def correlation_of_deviations(inputs: tuple[Input, ...]) -> np.ndarray:
    """(inputs, inputs) of the deviations themselves: less than that of the normal numbers behind them, unless they are normal;
    those of other kinds are counted among `COUNTED` draws."""
    hidden = correlation(inputs)
    if all(i.of.kind == "normal" for i in inputs if i.of.group):
        return hidden
    drawn = deviations(inputs, uniforms(inputs, "sobol", COUNTED, 0))
    with np.errstate(invalid="ignore"):  # what does not scatter goes along with nothing
        counted = np.nan_to_num(np.corrcoef(drawn.T))
    normal = np.array([i.of.kind == "normal" for i in inputs])
    known = (normal[:, None] & normal[None, :]) | (hidden == 0.0) | np.eye(len(inputs), dtype=bool)
    return np.where(known, hidden, counted)


def normals(inputs: tuple[Input, ...], u: np.ndarray) -> np.ndarray:
    """(samples, inputs) the normal numbers behind the inputs, of whatever kind: they have the `correlation`."""
    return stats.norm.ppf(deviates(inputs, u))


def epsilons(inputs: tuple[Input, ...], u: np.ndarray) -> np.ndarray:
    """(samples, inputs) standard deviates: value = nominal + offset + scale * epsilon. NaN for measured values."""
    found = deviates(inputs, u)
    for k, given in enumerate(inputs):
        found[:, k] = np.nan if given.column is not None else _deviate(given).ppf(found[:, k])
    return found


def deviations(inputs: tuple[Input, ...], u: np.ndarray) -> np.ndarray:
    """(samples, inputs) what is added to the nominal values, in each input's unit."""
    found = deviates(inputs, u)
    for k, given in enumerate(inputs):
        if given.column is not None:
            found[:, k] = np.quantile(given.column, found[:, k]) - given.nominal
        else:
            found[:, k] = given.of.offset + given.scale * _deviate(given).ppf(found[:, k])
    return found
