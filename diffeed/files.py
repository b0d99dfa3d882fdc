"""Numbers as JSON takes them, and files that are whole or not there."""

import os
import uuid
from pathlib import Path
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """JSON's own types, from numbers and arrays of Python, NumPy or JAX; a number that is not finite becomes None."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if value is None or isinstance(value, (str, bool, int)):
        return value
    array = np.asarray(value)
    if array.ndim:
        return plain(array.tolist())
    number = array.item()
    return None if isinstance(number, float) and not np.isfinite(number) else number


def write_whole(path: str | os.PathLike[str], text: str) -> None:
    """Replace a file by a text: whatever happens, the old one or the new one is there, whole."""
    target = os.path.realpath(path)
    draft = Path(target).with_name(f".{uuid.uuid4().hex}.part")
    try:
        with draft.open("x", encoding="utf-8", newline="\n") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(draft, target)
    finally:
        draft.unlink(missing_ok=True)
