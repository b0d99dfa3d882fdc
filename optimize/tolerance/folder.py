"""The folder of a tolerance study: what it belongs to, and one line of `samples.csv` for each sample that was run.

Lines are appended chunk by chunk; a kill leaves at most one broken line at the end, which resuming cuts off. Numbers are
written so that they read back as the same bits.
"""

import contextlib
import csv
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from diffeed import measures
from diffeed.base.files import write_whole
from diffeed.base.folders import DRAFT, Lock, OutputError, plain_errors
from diffeed.base.words import NAME
from optimize.tolerance.problem import ToleranceProblem
from optimize.tolerance.run import Rows, chosen, joined

MARK, RESULT = "study.json", "result.json"
"""The result is written last, by `optimize.tolerance.report`: a folder that holds it is complete."""
SAMPLES, INDICES = "samples", "indices"
"""Tables: of the samples, and of the runs for the Sobol indices."""
PICTURES = ("convergence.png", "tighten.png")
"""Of a whole study."""
FIXED = ("sample", "status", "reason", "time")
_ASKED = re.compile(rf"(?:measure|limit) ({NAME.pattern})")
"""A measure or limit in the headings of a table."""
_REPLAYED = re.compile(r"sample_[0-9]+\.(?:toml|html)")


def pictures_of(name: str) -> tuple[str, str, str]:
    """The pictures of a measure or limit: how it scatters, the same added up, what is to blame."""
    return f"{name}_histogram.png", f"{name}_distribution.png", f"{name}_contributions.png"


def names_of(sample: int) -> tuple[str, str]:
    """The files of a sample: its scene, and last its animation."""
    return f"sample_{sample}.toml", f"sample_{sample}.html"


class FolderError(Exception):
    """The folder cannot be used as asked."""


class Folder:
    """Writes and reads the rows of one study. `name`: which of its tables, SAMPLES or INDICES."""

    def __init__(self, place: Path, problem: ToleranceProblem, name: str = SAMPLES) -> None:
        self.place, self.problem = place, problem
        self.table = place / f"{name}.csv"
        self._stream: Any = None
        self._held: Any = None

    @property
    def columns(self) -> list[str]:
        asked = [f"measure {a.name}" for a in self.problem.measures] + [f"limit {a.name}" for a in self.problem.limits]
        broken = [f"broken {a.name}" for a in self.problem.limits]
        return [*FIXED, *asked, *broken, *(f"off {i.name}" for i in self.problem.inputs)]

    def start(self, resume: bool, force: bool) -> Rows | None:
        """What is there already; the table is then open for more."""
        try:
            with plain_errors(f"cannot write to {self.place}"):
                return self._start(resume, force)
        except OutputError as error:
            self.close()
            raise FolderError(str(error)) from error
        except FolderError:
            self.close()
            raise

    def _start(self, resume: bool, force: bool) -> Rows | None:
        mark = self.place / MARK
        if mark.exists():
            self._held = self._held or Lock(self.place)
        if resume or (self.table.stem != SAMPLES and not force):
            if not mark.exists():
                raise FolderError(f"{self.place} holds no study to resume")
            self.refuse_another(", or give --force instead of --resume to replace it")
        elif mark.exists() and not force:
            raise FolderError(
                f"{self.place} already holds a study; add --resume to go on with it, --force to replace it, or name "
                "another folder"
            )
        else:
            self._begin(mark)
        remedy = "give --force instead of --resume to begin anew"
        kept, done = self._read(remedy) if self.table.exists() else ("", None)
        if done is None:
            kept = _line(self.columns)
        (self.place / RESULT).unlink(missing_ok=True)  # the folder is not complete until it is written again
        write_whole(self.table, kept)
        self._stream = self.table.open("a", encoding="utf-8", newline="")
        return done

    def _begin(self, mark: Path) -> None:
        if self.place.exists() and not mark.exists() and any(not _ours(p) for p in self.place.iterdir()):
            raise FolderError(f"{self.place} holds other files; name an empty folder or a new one")
        self.place.mkdir(parents=True, exist_ok=True)
        self._held = self._held or Lock(self.place)
        for old in self._written():
            (self.place / old).unlink(missing_ok=True)
        write_whole(mark, json.dumps({"study": self.problem.key, "title": self.problem.study.title}) + "\n")

    def _written(self) -> list[str]:
        """What the study that is here wrote; all else is its user's. Last the table whose headings tell the names."""
        table, headings = f"{SAMPLES}.csv", ""
        if (self.place / table).exists():
            with (self.place / table).open(encoding="utf-8", errors="replace") as stream:
                headings = stream.readline()
        pictures = [picture for name in _ASKED.findall(headings) for picture in pictures_of(name)]
        replayed = [path.name for path in self.place.iterdir() if _REPLAYED.fullmatch(path.name)]
        return [RESULT, *PICTURES, *pictures, *replayed, f"{INDICES}.csv", table]

    def refuse_another(self, otherwise: str = "") -> None:
        """FolderError where another study is in the folder, with what may be done instead of naming another folder."""
        mark = self.place / MARK
        if not mark.exists():
            return
        try:
            owner = json.loads(mark.read_text("utf-8"))["study"]
        except (ValueError, KeyError, TypeError) as error:
            raise FolderError(f"{mark} cannot be read ({error}); name another folder{otherwise}") from error
        if owner != self.problem.key:
            raise FolderError(f"{self.place} holds another study; name another folder{otherwise}")

    def rows(self) -> Rows | None:
        """The rows that are on disk, to compare with."""
        return self._read("compare studies of the same tolerances, measures and limits")[1]

    def add(self, rows: Rows) -> None:
        try:
            self._stream.write("".join(_line(self._words(rows, k)) for k in range(len(rows.sample))))
            self._stream.flush()
        except OSError as error:
            raise FolderError(
                f"results could not be written to {self.place}: {error.strerror or error}; what was written before is kept, "
                "--resume goes on from there"
            ) from error

    def close(self) -> None:
        if self._stream is not None:
            with contextlib.suppress(OSError):  # what is left in the buffer of a full disk
                self._stream.close()
        if self._held is not None:
            self._held.close()
        self._stream = self._held = None

    def sort(self, rows: Rows) -> None:
        """The whole table again, in the order of the samples: workers finish in any order."""
        lines = (_line(self._words(rows, k)) for k in range(len(rows.sample)))
        try:
            self._stream.close()
            write_whole(self.table, _line(self.columns) + "".join(lines))
        except OSError as error:
            raise FolderError(f"cannot write to {self.place}: {error.strerror or error}") from error

    def _words(self, rows: Rows, k: int) -> list[str]:
        head = [str(int(rows.sample[k])), measures.STATUSES[int(rows.status[k])], str(int(rows.reason[k]))]
        numbers = [rows.time[k], *rows.values[k]]
        broken = ["1" if b else "0" for b in rows.broken[k]]
        return [*head, *(repr(float(v)) for v in numbers), *broken, *(repr(float(v)) for v in rows.deviation[k])]

    def _read(self, remedy: str) -> tuple[str, Rows | None]:
        """The text of the whole lines, and the rows in them. `remedy`: for the table of a study that asked for other things."""
        text = self.table.read_text("utf-8")
        whole = text[: text.rfind("\n") + 1]
        lines = list(csv.reader(io.StringIO(whole)))
        if not lines:
            return "", None
        if lines[0] != self.columns:
            raise FolderError(f"{self.table} does not start with the headings of this study; {remedy}")
        found = []
        for number, words in enumerate(lines[1:], start=2):
            try:
                found.append(self._row(words))
            except (ValueError, IndexError) as error:
                raise FolderError(f"{self.table}, line {number} cannot be read: {error}") from error
        return whole, joined(found) if found else None

    def _row(self, words: list[str]) -> Rows:
        if len(words) != len(self.columns):
            raise ValueError(f"{len(words)} entries where {len(self.columns)} belong")
        n, m = len(self.problem.asked), len(self.problem.limits)
        numbers = np.array([float(w) for w in words[3:]])
        cut = [1, 1 + n, 1 + n + m]
        time, values, broken, deviation = np.split(numbers, cut)
        status = measures.STATUSES.index(words[1])
        return Rows(
            np.array([int(words[0])]), deviation[None], np.array([status]), np.array([int(words[2])]), time, values[None],
            broken[None] > 0,
        )  # fmt: skip


def read_rows(place: Path, problem: ToleranceProblem, deviation: np.ndarray) -> Rows:
    """The rows of an earlier study of the same inputs and measures, to compare with: all those of n samples, which drew the
    same deviations (n, inputs). Raises FolderError."""
    folder = Folder(place, problem)
    if not folder.table.exists():
        raise FolderError(f"{place} holds no study to compare with")
    try:
        rows = folder.rows()
    except OSError as error:
        raise FolderError(f"{folder.table} cannot be read: {error.strerror or error}") from error
    there, first = np.unique([] if rows is None else rows.sample, return_index=True)
    first = first[there < len(deviation)]
    if rows is None or len(first) < len(deviation):
        raise FolderError(
            f"{folder.table} holds {len(first)} of the {len(deviation)} samples to compare with; finish that study with "
            "--resume, or ask for as many with --samples"
        )
    kept = chosen(rows, first)
    # A number that was measured is drawn as itself: its deviation is from another nominal value.
    drawn = [k for k, given in enumerate(problem.inputs) if given.column is None]
    if not np.allclose(kept.deviation[:, drawn], deviation[kept.sample][:, drawn], rtol=1e-9, atol=1e-12):
        raise FolderError(f"{place} drew other deviations: compare studies of the same tolerances, sampling and seed")
    return kept


def _ours(path: Path) -> bool:
    """A draft of a run that was killed, or the lock of an older version."""
    return path.name == ".lock" or (path.name.startswith(".") and path.name.endswith(DRAFT))


def _line(words: list[str]) -> str:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerow(words)
    return stream.getvalue()
