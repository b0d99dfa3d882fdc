"""Why a run is not to be believed: the causes by number, each with what helps against it."""

from typing import NamedTuple


class Cause(NamedTuple):
    """What went wrong, and what to do about it."""

    what: str
    remedy: str


SHORTER = "take shorter steps, or give a tolerance instead"
_ALL = (
    Cause("", ""),
    Cause("no rest state was found", 'set initial = "given" to start as written'),
    Cause("the numbers stopped being finite", SHORTER),
    Cause(
        "a bar or roller was pushed deeper into a body than it may be",
        "take shorter steps, a stiffer contact or less force",
    ),
    Cause("speeds grew past anything a feeder can do", SHORTER),
    Cause(
        "more bodies came near the sheet than the search keeps",
        "set crowded = true in the scene, which in equal steps keeps more; else take shorter steps, give a tolerance, or put"
        " fewer parts in one place",
    ),
    Cause("something moved further between two searches than the search reached", SHORTER),
    Cause("the tolerance asks for more steps than `most_steps` allows", "allow more, or a larger tolerance"),
    Cause("no step, however small, met the tolerance", "give a larger tolerance"),
    Cause(
        "the equations of a step have no solution",
        "look for clamps that hold the same thing twice, and for masses and stiffnesses of the wrong size",
    ),
    Cause("a body was approached by more in one step than its contact can resolve", SHORTER),
    Cause("speeds changed by more in one step than the step can resolve", SHORTER),
    Cause("energy came from nowhere", SHORTER),
    Cause("a bar lies across a guide", "see how it came there: shorter steps and shorter bars keep a sheet in front"),
    Cause("the steps are too short for single precision: the sheet no longer moves on", "take float64 or longer steps"),
    Cause("friction turned about within an explicit step", "take shorter steps, or an implicit method"),
    Cause(
        "a sheet came behind the face of a guide past its end",
        "if the sheet came in below the guide's end, which in the machine is a jam, give the guide a lead-in or move that"
        " end; turn the guide about if it bears on the wrong side (a line guide bears on the left of start to end, an arc on its"
        " `side`)",
    ),
    Cause(
        "the times of a profile or a movement are out of order",
        "keep each after the one before: bounds and tolerances must not cross",
    ),
    Cause(
        "a sheet was not thrown back from what it hit, for the hit was over within a few steps",
        "give the contact more damping, as real surfaces have, or take far shorter steps or a smaller tolerance",
    ),
)
CAUSES = tuple(cause.what for cause in _ALL)
"""Causes of a failed run, by number; 0 is none."""
REMEDIES = tuple(cause.remedy for cause in _ALL)
(
    NO_REST,
    NOT_FINITE,
    TOO_DEEP,
    TOO_FAST,
    TOO_MANY_NEAR,
    MOVED_TOO_FAR,
    OUT_OF_STEPS,
    TOO_SMALL,
    SINGULAR,
    UNRESOLVED,
    LEAPT,
    FROM_NOWHERE,
    ACROSS,
    FROZEN,
    TURNED_ABOUT,
    BEHIND,
    OUT_OF_ORDER,
    LOST_REBOUND,
) = range(1, len(_ALL))
