"""Static bookkeeping of the row of bars: names, counts, index arrays."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Layout:
    """Static bookkeeping of the row of bars: names, bar counts, index arrays."""

    names: tuple[str, ...]
    bars: tuple[int, ...]

    @cached_property
    def starts(self) -> tuple[int, ...]:
        return tuple(int(v) for v in np.cumsum((0, *self.bars)))

    @cached_property
    def n_bars(self) -> int:
        return sum(self.bars)

    @cached_property
    def sheet_of_bar(self) -> np.ndarray:
        return np.repeat(np.arange(len(self.bars)), self.bars)

    @cached_property
    def first(self) -> np.ndarray:
        """(bars,) bool: the bar leads its sheet."""
        return np.isin(np.arange(self.n_bars), self.starts[:-1])

    @cached_property
    def last(self) -> np.ndarray:
        return np.isin(np.arange(self.n_bars) + 1, self.starts[1:])

    @cached_property
    def tail(self) -> np.ndarray:
        """(features,) bool: the feature is a tail's end circle; the others are bars (on the smooth skin: pieces)."""
        return np.concatenate([np.arange(n + 1) == n for n in self.bars])

    @cached_property
    def sheet_of_feature(self) -> np.ndarray:
        """(features, sheets) bool."""
        return self.owner_of_feature[:, None] == np.arange(len(self.bars))[None, :]

    @cached_property
    def owner_of_feature(self) -> np.ndarray:
        """(features,) whole numbers: the same as an index."""
        return np.repeat(np.arange(len(self.bars), dtype=np.int32), np.array(self.bars) + 1)

    @cached_property
    def first_feature(self) -> np.ndarray:
        return np.concatenate([np.arange(n + 1) == 0 for n in self.bars])

    @cached_property
    def last_feature(self) -> np.ndarray:
        """(features,) bool: the feature is the last bar of its sheet."""
        return np.concatenate([np.arange(n + 1) == n - 1 for n in self.bars])

    @cached_property
    def bar_of_feature(self) -> np.ndarray:
        """(features,) the bar that starts at the feature's node; at a tail the last one."""
        return np.arange(self.tail.shape[0]) - self.owner_of_feature - self.tail

    @cached_property
    def bar_before_feature(self) -> np.ndarray:
        """(features,) the bar that ends at the feature's node; at a lead the first one."""
        return np.arange(self.tail.shape[0]) - self.owner_of_feature - ~self.first_feature

    def slices(self) -> list[slice]:
        return [slice(a, b) for a, b in zip(self.starts[:-1], self.starts[1:], strict=True)]

    def bar(self, sheet: str, at: Any, whole: bool = False) -> tuple[int, float]:
        """Bar in the row and which end of it (+1 front, -1 rear, 0 for a whole bar) that `at` names."""
        k = self.names.index(sheet)
        count, start = self.bars[k], self.starts[k]
        node = 0 if at == "lead" else count if at == "tail" else int(at)
        if whole:
            return start + min(node, count - 1), 0.0
        return (start + node, 1.0) if node < count else (start + count - 1, -1.0)
