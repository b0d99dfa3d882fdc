"""Compiled functions, kept by what they were made from: what is asked for again compiles nothing."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any

MOST = 32
"""Programs kept: the one that was not used for longest goes first."""

_KEPT: OrderedDict[Hashable, Any] = OrderedDict()


def kept(mark: Hashable, make: Callable[[], Any]) -> Any:
    """The program of this mark, made if there is none yet. Whatever changes the program must be in the mark."""
    if mark not in _KEPT:
        _KEPT[mark] = make()
        if len(_KEPT) > MOST:
            _KEPT.popitem(last=False)
    _KEPT.move_to_end(mark)
    return _KEPT[mark]
