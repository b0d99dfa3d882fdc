"""What the folders of searches and studies share: numbers as JSON takes them, and files that are whole or not there."""

import os
from pathlib import Path
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """JSON's own types; a number that is not finite becomes None."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    return value


def write_whole(path: Path, text: str) -> None:
    """Replace a file by a text: a kill leaves the old one or the new one."""
    draft = path.with_name(f".{path.name}.part")
    draft.write_text(text, "utf-8", newline="")
    os.replace(draft, path)
