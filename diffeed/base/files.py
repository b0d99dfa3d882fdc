"""Numbers as JSON takes them, and files that are whole or not there."""

import contextlib
import math
import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO


def plain(value: Any) -> Any:
    """JSON's own types, from numbers and arrays of Python, NumPy or JAX; a number that is not finite becomes None."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if value is None or isinstance(value, (str, bool, int)):
        return value
    import numpy as np  # only here: help texts must come at once

    array = np.asarray(value)
    if array.ndim:
        return plain(array.tolist())
    number = array.item()
    return None if isinstance(number, float) and not math.isfinite(number) else number


def write_whole(path: str | os.PathLike[str], text: str) -> None:
    """Replace a file by a text: whatever happens, the old one or the new one is there, whole."""
    with replacing(path) as stream:
        stream.write(text.encode("utf-8"))


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A stream whose bytes replace a file when all of them are written; after an error the old file stays.

    The draft is `.NAME.part` beside it. One that a killed process left is used again.
    """
    target = Path(os.path.realpath(path))
    stream = _draft(target)
    try:
        yield stream
        stream.flush()
        os.fsync(stream.fileno())
        os.replace(stream.name, target)
    except BaseException:
        Path(stream.name).unlink(missing_ok=True)
        raise
    finally:
        with contextlib.suppress(OSError):  # what is left in the buffer of a full disk
            stream.close()


def _draft(target: Path) -> BinaryIO:
    """An empty draft of a file that no other process writes: one of its own name where the usual one is taken."""
    draft = target.with_name(f".{target.name}.part")
    with contextlib.suppress(OSError):  # another user's
        descriptor = os.open(draft, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
        if _ours(descriptor, draft):
            os.ftruncate(descriptor, 0)
            return open(draft, "r+b", opener=lambda *_: descriptor)
        os.close(descriptor)
    return target.with_name(f".{uuid.uuid4().hex}.part").open("xb")


def _ours(descriptor: int, draft: Path) -> bool:
    """Whether the file that was opened is locked for this process, and still the one of that name."""
    held = locked(descriptor)
    if held is None:  # nobody uses a draft of that name
        draft.unlink(missing_ok=True)
    try:
        return bool(held) and os.path.samestat(os.fstat(descriptor), draft.stat())
    except FileNotFoundError:  # another process has just written it
        return False


def locked(descriptor: int) -> bool | None:
    """Lock an open file or folder for this process, until it is closed; False: another has it; None: no locks here."""
    try:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except (ImportError, OSError):  # not on this system, or not on this file system
        return None
    return True
