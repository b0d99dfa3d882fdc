"""The folder of a search: one line per iteration, the whole state after each, and what it belongs to.

`state.npz` is replaced whole, after the line of its iteration was written: a kill at any moment leaves a state and at most
one line too many, which resuming cuts off. Arrays only: nothing is unpickled.
"""

import contextlib
import dataclasses
import hashlib
import json
import os
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from diffeed.base.files import plain, replacing, write_whole
from diffeed.base.folders import Lock, OutputError, plain_errors, refuse_overwriting
from diffeed.base.words import short
from optimize.descent import Line, Progress, begin, stop
from optimize.evaluate import Counts
from optimize.problem import Problem

HISTORY, STATE, SUMMARY = "history.jsonl", "state.npz", "result.json"
"""The summary is written last, by `optimize.report`: a folder that holds it is complete."""
FILES = (
    "scene.toml", "before_after.html", "history.png", "variables.png", "blame_before.png", "blame_after.png",
    "when_before.png", SUMMARY,
)  # fmt: skip
"""What `optimize.report` writes beside a search."""


class JournalError(Exception):
    """The folder cannot be used as asked."""


@contextlib.contextmanager
def refusing_folder(what: str) -> Iterator[None]:
    """Errors of the file system as JournalError."""
    try:
        with plain_errors(what):
            yield
    except OutputError as error:
        raise JournalError(str(error)) from error


def fingerprint(problem: Problem) -> str:
    """What a search belongs to: the study (budgets aside) and the scenes as run. Earlier stages must stay as long as they
    were: where the last one begins follows from them."""
    search = problem.study.search.model_dump(mode="json", exclude={"seconds", "iterations", "patience", "goal"})
    for last in search["stages"][-1:]:
        del last["iterations"]
    return hashlib.sha256(json.dumps([search, problem.key], sort_keys=True).encode()).hexdigest()


class Journal:
    """Writes and reads one folder, which no other process writes until it is closed."""

    def __init__(self, folder: Path, problem: Problem) -> None:
        self.folder, self.problem = folder, problem
        self.earlier: list[dict[str, Any]] = []
        """Lines of the search that is gone on with."""
        self._lines: Any = None
        self._lock: Lock | None = None

    def start(self, resume: bool, force: bool) -> Progress:
        """A fresh search, or the one that stopped here: afresh too, if it stopped before the end of its first iteration."""
        try:
            with refusing_folder(f"cannot write to {self.folder}"):
                return self._start(resume, force)
        except JournalError:
            self.close()
            raise

    def _start(self, resume: bool, force: bool) -> Progress:
        state, history = self.folder / STATE, self.folder / HISTORY
        if resume and not (state.exists() or history.exists()):
            raise JournalError(f"{self.folder} holds no search to resume")
        self.folder.mkdir(parents=True, exist_ok=True)
        self._lock = Lock(self.folder)
        if not (resume or force) and (state.exists() or history.exists()):
            raise JournalError(
                f"{self.folder} already holds a search; add --resume to go on with it, --force to replace it, "
                "or name another folder"
            )
        if not (resume or force):  # results of something else, a run or a study, whole as they are
            refuse_overwriting(self.folder, tuple(name for name in FILES if os.path.lexists(self.folder / name)))
        if resume and state.exists():
            progress = self._read(state)
            if progress.reason:
                if (self.folder / SUMMARY).exists():  # its result is written: more is wanted, so patience counts anew
                    progress.since = progress.iteration
                progress.reason = ""
                stop(self.problem, progress)  # beyond its budgets only if they have grown
            lines = history.read_text("utf-8").splitlines()[: progress.iteration] if history.exists() else []
        else:
            progress, lines = begin(self.problem), []
            state.unlink(missing_ok=True)
        (self.folder / SUMMARY).unlink(missing_ok=True)  # the folder is not complete until it is written again
        write_whole(history, "".join(line + "\n" for line in lines))
        self.earlier = [json.loads(line) for line in lines]
        self._lines = history.open("a", encoding="utf-8")
        return progress

    def save(self, progress: Progress, line: Line) -> None:
        what = f"the search could not be written to {self.folder}; --resume goes on with what is there"
        with refusing_folder(what):
            self._lines.write(json.dumps(plain(line._asdict()), allow_nan=False) + "\n")
            self._lines.flush()
            with replacing(self.folder / STATE) as stream:
                np.savez(stream, **_pack(progress, fingerprint(self.problem)))  # type: ignore[arg-type]

    def close(self) -> None:
        if self._lines is not None:
            with contextlib.suppress(OSError):  # what is left in the buffer of a full disk
                self._lines.close()
        if self._lock is not None:
            self._lock.close()

    def _read(self, path: Path) -> Progress:
        try:
            with path.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
                arrays = {k: data[k] for k in data.files}
            if str(arrays["fingerprint"]) != fingerprint(self.problem):
                raise JournalError(
                    f"{self.folder} holds the search of another study; name another folder, or add --force"
                )
            return _unpack(arrays, self.problem)
        except (OSError, EOFError, ValueError, TypeError, KeyError, zipfile.BadZipFile) as error:
            raise JournalError(
                f"{path} is not the state of a search ({short(str(error))}); add --force to begin anew"
            ) from error


_ARRAYS = tuple(f.name for f in dataclasses.fields(Progress) if f.name not in ("state", "counts", "reason"))


def _pack(progress: Progress, mark: str) -> dict[str, np.ndarray]:
    arrays = {name: np.asarray(getattr(progress, name)) for name in _ARRAYS}
    arrays["counts"] = np.array(progress.counts)
    for k, leaf in enumerate(jax.tree.leaves(progress.state)):
        arrays[f"state.{k}"] = np.asarray(leaf)
    return arrays | {"fingerprint": np.array(mark), "reason": np.array(progress.reason)}


def _unpack(arrays: dict[str, np.ndarray], problem: Problem) -> Progress:
    fresh = begin(problem)
    kinds = {f.name: type(getattr(fresh, f.name)) for f in dataclasses.fields(Progress)}
    given: dict[str, Any] = {n: kinds[n](arrays[n]) if kinds[n] in (int, float) else arrays[n] for n in _ARRAYS}
    leaves, structure = jax.tree.flatten(fresh.state)
    state = structure.unflatten([arrays[f"state.{k}"] for k in range(len(leaves))])
    return Progress(**given, state=state, counts=Counts(*map(int, arrays["counts"])), reason=str(arrays["reason"]))
