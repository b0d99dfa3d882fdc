"""Arrays as a player page holds them."""

import base64
from typing import Any

import numpy as np


def unpack(packed: dict[str, Any]) -> np.ndarray:
    """The inverse of `player_data.pack`."""
    values = np.frombuffer(base64.b64decode(packed["f32"]), dtype="<f4")
    if "index" not in packed:
        return values.reshape(packed["shape"])
    full = np.zeros(int(np.prod(packed["shape"])), dtype="<f4")
    full[np.frombuffer(base64.b64decode(packed["index"]), dtype="<u4")] = values
    return full.reshape(packed["shape"])
