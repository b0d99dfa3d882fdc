"""Folders of results: one process writes at a time, files come all together, and a draft is known by its name.

A killed process leaves at most one draft: `FOLDER/.part`, or `.FOLDER.part` beside a folder that is not there yet. The next
run into that folder removes it: the lock on it, which goes with its process, tells whether anything still writes there.
"""

import contextlib
import os
import shutil
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from diffeed.base.files import locked

DRAFT = ".part"


class OutputError(Exception):
    """Files cannot be written, or must not be."""


@contextmanager
def plain_errors(what: str) -> Iterator[None]:
    """Errors of the file system become one sentence."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"{what}: {error.strerror or error}") from error


def refuse_overwriting(folder: Path, files: tuple[str, ...]) -> None:
    """Nothing is overwritten without being asked to. The last of `files` is the one that is written last."""
    if os.path.lexists(folder) and not folder.is_dir():
        raise OutputError(f"{folder} is a file; name a folder for the results")
    there = [name for name in files if os.path.lexists(folder / name)]
    if there:
        part = "" if files[-1] in there else f" (of a run that was stopped while it wrote: {files[-1]} is missing)"
        raise OutputError(
            f"{folder} already holds {', '.join(there)}{part}; name another folder, or add --force to replace them"
        )


# --- one writer at a time -------------------------------------------------------------------------------------------------

_HELD: set[tuple[int, int]] = set()
"""Folders that this process holds for a whole command: device and inode."""


class Lock:
    """Keeps other processes from writing into a folder that is there, until it is closed or the process ends."""

    def __init__(self, folder: Path) -> None:
        self.descriptor = None if _key(folder) in _HELD else _locked(folder)

    def close(self) -> None:
        if self.descriptor is not None:
            os.close(self.descriptor)
            self.descriptor = None


@contextmanager
def holding(folder: Path | None) -> Iterator[None]:
    """For a whole command: the folder is made, and written by this process alone. None: nothing is to be written."""
    if folder is None:
        yield
        return
    made = not folder.exists()
    with plain_errors(f"cannot write to {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
        lock, key = Lock(folder), _key(folder)
    _HELD.add(key)
    try:
        yield
    finally:
        _HELD.discard(key)
        if made:
            with contextlib.suppress(OSError):
                folder.rmdir()  # unless something was written
        lock.close()


def _key(path: Path) -> tuple[int, int]:
    found = path.stat()
    return found.st_dev, found.st_ino


def _locked(folder: Path) -> int | None:
    """A descriptor that holds the folder's lock; None where the system has no such locks. OutputError if another has it."""
    if not hasattr(os, "O_DIRECTORY"):  # folders cannot be opened on this system
        return None
    descriptor = os.open(folder, os.O_RDONLY)
    held = locked(descriptor)
    if held:
        return descriptor
    os.close(descriptor)
    if held is None:
        return None
    raise OutputError(f"{folder} is being written by another run; wait for its end, or name another folder")


# --- all files together ---------------------------------------------------------------------------------------------------


@contextmanager
def draft_of(folder: Path, files: tuple[str, ...] = ()) -> Iterator[Path]:
    """An empty folder for the files of `folder`, gone at the end whatever happens. Opened early, to fail before a long run:
    where one of `files` is there already, and where another run has a draft."""
    with plain_errors(f"cannot write to {folder}"):
        refuse_overwriting(folder, files)
        target = Path(os.path.realpath(folder))
        draft, lock = _inside(target) if target.is_dir() else _beside(target, folder)
    own = _key(draft)
    try:
        refuse_overwriting(folder, files)  # what another run wrote before the lock was ours
        yield draft
    finally:
        with contextlib.suppress(OSError):
            if _key(draft) == own:  # it was not moved into place, whereupon another run made its own
                shutil.rmtree(draft, ignore_errors=True)
        lock.close()


def _inside(target: Path) -> tuple[Path, Lock]:
    """The draft of a folder that is there, on the same file system even if that is another one than its parent's."""
    lock = Lock(target)
    draft = target / (DRAFT if lock.descriptor is not None else f".{uuid.uuid4().hex}{DRAFT}")
    try:
        shutil.rmtree(draft, ignore_errors=True)  # of a run that was killed
        draft.mkdir()
    except OSError:
        lock.close()
        raise
    return draft, lock


def _beside(target: Path, folder: Path) -> tuple[Path, Lock]:
    """The draft of a folder that is not there yet, locked; one that a killed run left is used again."""
    draft = target.with_name(f".{target.name}{DRAFT}")
    while True:
        draft.mkdir(parents=True, exist_ok=True)
        try:
            lock = Lock(draft)
        except FileNotFoundError:  # its run has just ended
            continue
        except OutputError:
            raise OutputError(
                f"{folder} is being written by another run; wait for its end, or name another folder"
            ) from None
        if lock.descriptor is None:
            with contextlib.suppress(OSError):
                draft.rmdir()
            draft = target.with_name(f".{target.name}.{uuid.uuid4().hex}{DRAFT}")
            draft.mkdir()
            return draft, lock
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(draft.stat(), os.fstat(lock.descriptor)):
                break
        lock.close()  # it was another run's, which has just moved it into place
    for old in draft.iterdir():
        if old.is_dir() and not old.is_symlink():
            shutil.rmtree(old)
        else:
            old.unlink()
    return draft, lock


@contextmanager
def publishing(folder: Path | None, files: tuple[str, ...], force: bool) -> Iterator[Path | None]:
    """A draft whose files are moved to `folder` at the end. None: nothing is to be written."""
    if folder is None:
        yield None
        return
    with draft_of(folder, () if force else files) as draft:
        yield draft
        with plain_errors(f"the results were not written to {folder}"):
            publish(draft, folder, files)


def write_all(
    draft: Path, folder: Path, writers: dict[str, Callable[[Path], Any]], files: tuple[str, ...]
) -> list[str]:
    """Write into the draft, then move to `folder`, in place of all `files` of an earlier run; the names written."""
    with plain_errors(f"the results were not written to {folder}"):
        for name, write in writers.items():
            write(draft / name)
        return publish(draft, folder, files)


def publish(draft: Path, folder: Path, files: tuple[str, ...]) -> list[str]:
    """Move the draft into place: in one go if there is no such folder yet, else file by file, the last of `files` last."""
    names = [name for name in files if (draft / name).exists()]
    target = Path(os.path.realpath(folder))
    if not target.exists():
        os.rename(draft, target)
        return names
    if draft.parent == target:
        _replace(draft, target, names, files)
        return names
    lock = Lock(target)  # the folder came while this run went on
    try:
        refuse_overwriting(folder, files)
        _replace(draft, target, names, files)
    finally:
        lock.close()
    return names


def _replace(draft: Path, target: Path, names: list[str], files: tuple[str, ...]) -> None:
    for name in reversed(files):
        (target / name).unlink(missing_ok=True)
    for name in names:
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        os.replace(draft / name, target / name)
