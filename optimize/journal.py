"""The folder of a search: one line per iteration, the whole state after each, and what it belongs to.

`state.npz` is replaced whole, after the line of its iteration was written: a kill at any moment leaves a state and at most
one line too many, which resuming cuts off. Arrays only: nothing is unpickled.
"""

import dataclasses
import hashlib
import json
import os
from pathlib import Path
from typing import Any

import jax
import numpy as np

from diffeed.files import plain, write_whole
from optimize.descent import Line, Progress, begin
from optimize.evaluate import Counts
from optimize.problem import Problem

HISTORY, STATE = "history.jsonl", "state.npz"


class JournalError(Exception):
    """The folder cannot be used as asked."""


def fingerprint(problem: Problem) -> str:
    """What a search belongs to: the study (budgets aside) and the scenes as run."""
    search = problem.study.search.model_dump(mode="json", exclude={"seconds", "iterations", "patience", "goal"})
    return hashlib.sha256(json.dumps([search, problem.key], sort_keys=True).encode()).hexdigest()


class Journal:
    """Writes and reads one folder."""

    def __init__(self, folder: Path, problem: Problem) -> None:
        self.folder, self.problem = folder, problem
        self._lines: Any = None

    def start(self, resume: bool, force: bool) -> Progress:
        """A fresh search, or the one that stopped here."""
        state, history = self.folder / STATE, self.folder / HISTORY
        if resume:
            progress = self._read(state)
            lines = history.read_text("utf-8").splitlines()[: progress.iteration] if history.exists() else []
            write_whole(history, "".join(line + "\n" for line in lines))
        else:
            if (state.exists() or history.exists()) and not force:
                raise JournalError(
                    f"{self.folder} already holds a search; add --resume to go on with it, --force to replace it, "
                    "or name another folder"
                )
            try:
                self.folder.mkdir(parents=True, exist_ok=True)
                for old in (state, history):
                    old.unlink(missing_ok=True)
            except OSError as error:
                raise JournalError(f"cannot write to {self.folder}: {error.strerror or error}") from error
            progress = begin(self.problem)
        self._lines = history.open("a", encoding="utf-8")
        return progress

    def save(self, progress: Progress, line: Line) -> None:
        try:
            self._lines.write(json.dumps(plain(line._asdict()), allow_nan=False) + "\n")
            self._lines.flush()
            _write_arrays(self.folder / STATE, _pack(progress, fingerprint(self.problem)))
        except OSError as error:
            raise JournalError(
                f"the search could not be written to {self.folder}: {error.strerror or error}"
            ) from error

    def close(self) -> None:
        if self._lines is not None:
            self._lines.close()

    def _read(self, path: Path) -> Progress:
        if not path.exists():
            raise JournalError(f"{self.folder} holds no search to resume")
        try:
            with np.load(path, allow_pickle=False) as data:
                arrays = {k: data[k] for k in data.files}
            if str(arrays["fingerprint"]) != fingerprint(self.problem):
                raise JournalError(
                    f"{self.folder} holds the search of another study; name another folder, or add --force"
                )
            return _unpack(arrays, self.problem)
        except (OSError, ValueError, KeyError) as error:
            raise JournalError(f"{path} cannot be read: {error}") from error


def read_history(folder: Path) -> list[dict[str, Any]]:
    """The lines of a search."""
    return [json.loads(line) for line in (folder / HISTORY).read_text("utf-8").splitlines()]


_ARRAYS = tuple(f.name for f in dataclasses.fields(Progress) if f.name not in ("state", "counts", "reason"))


def _pack(progress: Progress, mark: str) -> dict[str, np.ndarray]:
    arrays = {name: np.asarray(getattr(progress, name)) for name in _ARRAYS}
    arrays["counts"] = np.array(progress.counts)
    for k, leaf in enumerate(jax.tree.leaves(progress.state)):
        arrays[f"state.{k}"] = np.asarray(leaf)
    return arrays | {"fingerprint": np.array(mark), "reason": np.array(progress.reason)}


def _unpack(arrays: dict[str, np.ndarray], problem: Problem) -> Progress:
    """A search that had ended goes on: its reason is not kept."""
    fresh = begin(problem)
    kinds = {f.name: type(getattr(fresh, f.name)) for f in dataclasses.fields(Progress)}
    given: dict[str, Any] = {n: kinds[n](arrays[n]) if kinds[n] in (int, float) else arrays[n] for n in _ARRAYS}
    leaves, structure = jax.tree.flatten(fresh.state)
    state = structure.unflatten([arrays[f"state.{k}"] for k in range(len(leaves))])
    return Progress(**given, state=state, counts=Counts(*map(int, arrays["counts"])))


def _write_arrays(path: Path, arrays: dict[str, np.ndarray]) -> None:
    draft = path.with_name(f".{path.name}.part")
    with draft.open("wb") as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]
    os.replace(draft, path)
