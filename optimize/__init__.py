"""optimize: the design loop on the gradients of diffeed.

import optimize
result = optimize.design(optimize.load_study("nip_slip"))
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from optimize.asked import StudyError
    from optimize.blame import arising, blame
    from optimize.design import Result, design
    from optimize.problem import Problem, make_problem
    from optimize.study import Goal, Limit, Medium, Search, Stage, Study, Variable
    from optimize.study_file import load_study, make_study, shipped_studies
    from optimize.terms import TERMS
    from optimize.trust import check_study

_HOMES = {
    "asked": ("StudyError",),
    "blame": ("arising", "blame"),
    "design": ("Result", "design"),
    "problem": ("Problem", "make_problem"),
    "study": ("Goal", "Limit", "Medium", "Search", "Stage", "Study", "Variable"),
    "study_file": ("load_study", "make_study", "shipped_studies"),
    "terms": ("TERMS",),
    "trust": ("check_study",),
}
_MODULE_OF = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "TERMS",
    "Goal",
    "Limit",
    "Medium",
    "Problem",
    "Result",
    "Search",
    "Stage",
    "Study",
    "StudyError",
    "Variable",
    "arising",
    "blame",
    "check_study",
    "design",
    "load_study",
    "make_problem",
    "make_study",
    "shipped_studies",
]


def __getattr__(name: str) -> Any:
    """Import a name when it is first used, so that help texts come at once."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'optimize' has no attribute {name!r}")
    value = getattr(import_module(f"optimize.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value
