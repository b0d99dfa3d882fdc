"""Dead loads."""

from diffeed.chain.kinematics import Pose
from diffeed.chain.system import BarTerms
from diffeed.forces.terms import bar_terms, on_bar, summed
from diffeed.model.arrays import Model


def pushes(model: Model, at: Pose) -> BarTerms | None:
    """Dead forces and moments on nodes."""
    if not model.pushes:
        return None
    found = []
    for p in model.pushes:
        arm = p.end * model.bars.half_length[p.bar]
        moment = p.moment + arm * (at.c[p.bar] * p.y - at.s[p.bar] * p.x)
        found.append(
            bar_terms(model, **{k: on_bar(model, p.bar, v) for k, v in (("fx", p.x), ("fy", p.y), ("fw", moment))})
        )
    return summed(found)
