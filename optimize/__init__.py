"""optimize: the design loop on the gradients of diffeed, and tolerance studies.

import optimize
result = optimize.design(optimize.load_study("nip_slip"))
rows = optimize.run_study(optimize.load_tolerance("film_tolerances", samples=64))
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from optimize.asked import StudyError
    from optimize.blame_map import arising, blame
    from optimize.confirmation import Confirmation, confirm
    from optimize.design_run import Result, design
    from optimize.problem import Problem, make_problem
    from optimize.study import Goal, Limit, Medium, Robust, Search, Stage, Study, Variable
    from optimize.study_file import load_study, make_study, shipped_studies
    from optimize.terms import TERMS
    from optimize.tolerance.latitude import latitude
    from optimize.tolerance.problem import ToleranceProblem, load_tolerance, make_tolerance
    from optimize.tolerance.study import run_rows, run_study
    from optimize.tolerance.summary import summarise
    from optimize.trust import check_study

_HOMES = {
    "asked": ("StudyError",),
    "blame_map": ("arising", "blame"),
    "confirmation": ("Confirmation", "confirm"),
    "design_run": ("Result", "design"),
    "problem": ("Problem", "make_problem"),
    "study": ("Goal", "Limit", "Medium", "Robust", "Search", "Stage", "Study", "Variable"),
    "study_file": ("load_study", "make_study", "shipped_studies"),
    "terms": ("TERMS",),
    "tolerance.latitude": ("latitude",),
    "tolerance.problem": ("ToleranceProblem", "load_tolerance", "make_tolerance"),
    "tolerance.study": ("run_rows", "run_study"),
    "tolerance.summary": ("summarise",),
    "trust": ("check_study",),
}
_MODULE_OF = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "TERMS",
    "Confirmation",
    "Goal",
    "Limit",
    "Medium",
    "Problem",
    "Result",
    "Robust",
    "Search",
    "Stage",
    "Study",
    "StudyError",
    "ToleranceProblem",
    "Variable",
    "arising",
    "blame",
    "check_study",
    "confirm",
    "design",
    "latitude",
    "load_study",
    "load_tolerance",
    "make_problem",
    "make_study",
    "make_tolerance",
    "run_rows",
    "run_study",
    "shipped_studies",
    "summarise",
]


def __getattr__(name: str) -> Any:
    """Import a name when it is first used, so that help texts come at once."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'optimize' has no attribute {name!r}")
    value = getattr(import_module(f"optimize.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value
