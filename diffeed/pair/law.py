"""The contact law of one pair: penetration and speeds in, forces and their slopes out. No geometry, no sums.

Source: the power law with indentation damping, clipped at zero (source paper, eq. 6, with the sign and the clip that
keep it from pulling), and friction mu(v) f_n (eq. 7), in one of two kinds. Regularised over a stick speed, it creeps
under load. Or it sticks: the surfaces hold each other through an elastic tangential deflection, as bristles do, that
slips when friction is at its limit (after Dahl and the bristle models; here with a bound on the deflection instead of a
relaxation towards it, so that what is held below the limit stands still).
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from diffeed.base.records import record
from diffeed.base.smooth import divide, power, powers, ramp

NEWTON = 1000.0
"""kg mm/s2 in one newton: the one place where forces change unit."""
SLIDES = 1.5
"""Deflection, in stick displacements, at which friction is at its limit: the bound of the deflection."""
BRISTLE_LAG = 3e-5
"""s: damping over stiffness of the tangential deflection, so that sticking contacts do not ring for ever. Implicit steps
damp far more. A longer one would shorten the steps of explicit methods below what the damping of nips asks of them."""


@record
class Surface:
    """Contact properties, one entry per body or pair. Forces in kg mm/s2."""

    friction: Any  # None: no set has any
    stiffness: Any
    exponent: Any
    damping: Any  # None: no set has any
    damping_exponent: Any
    smoothing: Any
    stick_speed: Any
    static_excess: Any  # static over dynamic friction, minus 1; None: every set has one coefficient
    transition_speed: Any
    tanh: Any  # bool per entry, or None when none follows it
    stick: Any = None  # bool per entry, or None when none sticks
    stick_displacement: Any = None  # mm, None when none sticks


class Touch(NamedTuple):
    """Forces of the law at the present state and their slopes."""

    force: Array  # F >= 0, kg mm/s2
    stiffness: Array  # K = max(0, dF/dd), kg/s2
    damping: Array | None  # C = dF/dd', kg/s; None: no set is damped
    friction: Array  # kg mm/s2, along -t: mu F phi(v_t), or what the deflection holds
    secant: Array | None  # by how much it grows with v_t, kg/s; None: no set has friction


class Grip(NamedTuple):
    """The tangential deflection that sticking pairs start from."""

    deflection: Array  # over stick_displacement, along t: how far the sheet has been dragged over the body
    ahead: Array | float  # s: friction is that of the deflection after this time; an implicit step's length, else 0
    pressed: Array | None = None  # kg mm/s2: the normal force by which it holds, if it is not the present one


def contact_law(
    surface: Surface,
    penetration: Array,
    v_n: Array,
    v_t: Array,
    friction_factor: Array | float,
    grip: Grip | None = None,
) -> Touch:
    """The law for pairs with `penetration` (mm), separation speed `v_n` (mm/s) and sliding speed `v_t` (mm/s).

    F = max(0, k D(d)^m + c D(d)^n d') with d' = -v_n. Where the clip acts, K and C are zero too. For n > m, dF/dd can
    turn negative: K keeps its positive part so that the step's matrix stays positive. Without a `grip` all sets follow
    the regularised law.
    """
    depth, _ = ramp(penetration, surface.smoothing)
    touching = depth > 0
    # The slope of the ramp over its depth: 2/d where it is bent, then 1/D.
    half = jnp.where(penetration < surface.smoothing, 0.5 * penetration, depth)
    per_depth = 1.0 / jnp.where(touching, half, 1.0)
    if surface.damping is None:
        force = surface.stiffness * power(depth, surface.exponent)
        stiffness, damping = force * surface.exponent * per_depth, None
    else:
        elastic_power, damping_power = powers(depth, (surface.exponent, surface.damping_exponent))
        elastic, damping = surface.stiffness * elastic_power, surface.damping * damping_power
        raw = elastic - damping * v_n
        pushing = touching & (raw > 0)
        tangent = (elastic * surface.exponent - damping * surface.damping_exponent * v_n) * per_depth
        force = jnp.where(pushing, raw, 0.0)
        stiffness = jnp.where(pushing, jnp.maximum(tangent, 0.0), 0.0)
        damping = jnp.where(pushing, damping, 0.0)
    return with_friction(surface, Touch(force, stiffness, damping, force, None), v_t, friction_factor, grip)


def with_friction(
    surface: Surface, touch: Touch, v_t: Array, friction_factor: Array | float, grip: Grip | None
) -> Touch:
    """The same normal force with the friction of the law at a sliding speed `v_t` (mm/s)."""
    if surface.friction is None:
        return touch._replace(friction=jnp.zeros_like(touch.force), secant=None)
    secant = friction_factor * touch.force * friction_secant(surface, v_t)
    sliding = touch._replace(friction=secant * v_t, secant=secant)
    if grip is None or surface.stick is None:
        return sliding
    held, held_secant = stick_friction(surface, v_t, grip)
    limit = friction_factor * (touch.force if grip.pressed is None else grip.pressed)
    return sliding._replace(
        friction=jnp.where(surface.stick, limit * held, sliding.friction),
        secant=jnp.where(surface.stick, limit * held_secant, secant),
    )


def friction_secant(surface: Surface, v_t: Array) -> Array:
    """mu(v) phi(v)/v in s/mm: phi = v/sqrt(v^2 + vs^2), or tanh(v/vs) where the set asks for it.

    mu(v) falls from the static to the dynamic value as 1/(1 + (v/transition_speed)^2).
    """
    secant = 1.0 / jnp.sqrt(v_t * v_t + surface.stick_speed**2)
    if surface.tanh is not None:
        small = jnp.abs(v_t) < 1e-6 * surface.stick_speed
        safe = jnp.where(small, surface.stick_speed, v_t)
        curved = jnp.where(small, 1.0 / surface.stick_speed, jnp.tanh(safe / surface.stick_speed) / safe)
        secant = jnp.where(surface.tanh, curved, secant)
    secant = surface.friction * secant
    if surface.static_excess is not None:
        secant = secant * _static_share(surface, v_t)
    return secant


def _static_share(surface: Surface, v_t: Array) -> Array:
    return 1.0 + surface.static_excess / (1.0 + (v_t / surface.transition_speed) ** 2)


def stick_friction(surface: Surface, v_t: Array, grip: Grip) -> tuple[Array, Array]:
    """mu(v) psi(z) and mu(v) psi(z)/z dz/dv (s/mm), where z is the deflection `grip.ahead` and the lag later.

    psi(z) = z - 4 z^3/27 up to z = 3/2, then 1, odd: friction rises from slope mu F/stick_displacement to exactly mu F,
    and arrives there without a corner. The secant leads a step from stick to slip and back without overshooting.
    """
    later = (grip.ahead + BRISTLE_LAG) / surface.stick_displacement
    reach = grip.deflection + later * v_t
    share = surface.friction * _held_share(reach)
    if surface.static_excess is not None:
        share = share * _static_share(surface, v_t)
    return share * reach, share * later


def friction_after(surface: Surface, touch: Touch, v_t: Array, gained: Array, ahead: Array, grip: Grip | None) -> Array:
    """Friction under the same normal force once the sliding speed is `gained` (mm/s) more, as for `ahead` (s) it has been."""
    assert touch.secant is not None, "only where a set has friction"
    later = v_t + gained
    slides = touch.secant * divide(friction_secant(surface, later), friction_secant(surface, v_t)) * later
    if grip is None or surface.stick is None:
        return slides
    dragged = grip._replace(deflection=grip.deflection + ahead * gained / surface.stick_displacement)
    held = divide(stick_friction(surface, later, dragged)[0], stick_friction(surface, v_t, grip)[1])
    return jnp.where(surface.stick, touch.secant * held, slides)


def _held_share(reach: Array) -> Array:
    """psi(z)/z. The division is made safe for the gradient of the branch that is not taken, without a tie at the bound."""
    size = jnp.abs(reach)
    holds = size < SLIDES
    return jnp.where(holds, 1.0 - reach * reach / (3.0 * SLIDES**2), 1.0 / jnp.where(holds, SLIDES, size))


def stick_deflection(share: Array) -> Array:
    """The deflection that holds a share of the limit, -1 to 1: the inverse of psi, z = 3 sin(arcsin(share)/3).

    Cut just below 1, where its slope is infinite.
    """
    return 2.0 * SLIDES * jnp.sin(jnp.arcsin(jnp.clip(share, -1.0 + 1e-6, 1.0 - 1e-6)) / 3.0)


def elastic_force(surface: Surface, penetration: Array) -> Array:
    """Force of the spring of a contact alone, kg mm/s2."""
    depth, _ = ramp(penetration, surface.smoothing)
    return surface.stiffness * power(depth, surface.exponent)


def elastic_energy(surface: Surface, penetration: Array) -> Array:
    """Energy stored in the spring of a contact, kg mm2/s2: k D^(m+1)/(m+1) of the ramp, by its exact integral.

    For the linear ramp beyond the smoothing length; inside it D = d^2/(2 s) gives the integral k D^m d/(2 m + 1).
    """
    depth, _ = ramp(penetration, surface.smoothing)
    m, s = surface.exponent, surface.smoothing
    rounded = surface.stiffness * power(depth, m) * penetration / (2.0 * m + 1.0)
    corner = surface.stiffness * power(0.5 * s, m) * s / (2.0 * m + 1.0)
    shift = surface.stiffness * power(0.5 * s, m) * 0.5 * s / (m + 1.0)
    straight = corner + surface.stiffness * power(depth, m) * depth / (m + 1.0) - shift
    return jnp.where(penetration < s, jnp.where(penetration > 0, rounded, 0.0), straight)
