"""Momentum, energy, rest and contact forces: what mechanics demands of every run.

Rows of the list of properties: 11 to 18, 20 and 21. Runs have a frame at every step, so that integrals over frames see
what the method saw.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases.ledger import Ledger, input_power, integral, ledger
from cases.scenes import DT, HIGH_ORDER, METHODS, ORDER, draw, nip, rod, run, slide, squeeze, strut
from cases.transforms import shifted

import diffeed
from diffeed.base.records import replace
from diffeed.chain.state import initial_state
from diffeed.contact.features import features
from diffeed.input.parts import Scene
from diffeed.model.build import build
from diffeed.pair.law import NEWTON, Surface, contact_law
from diffeed.readings.snapshot import look

STEPS = 200
FAR = np.array([0.0, 1e3])
SEEDS = (0, 1, 2)


def every_step(scene: Scene, method: str, dt: float = DT) -> tuple[diffeed.Trajectory, Ledger]:
    """A run of 200 steps with a frame at each, and its ledger."""
    trajectory = run(scene, method, duration=STEPS * dt, dt=dt, frames=STEPS + 1, observe=("energy",))
    return trajectory, ledger(scene, trajectory.states)


def slider(seed: int, damped: bool = True, friction: bool = True) -> Scene:
    """A sheet in contact with fixed guides. The arc stands off the line: across a joined end a contact fades over a
    quarter of a millimetre, and the energy stored in it changes by that without work (1e-5 of the energy here)."""
    scene = slide(np.random.default_rng(seed))
    turn = scene.guides["turn"]
    scene = replace(scene, guides=scene.guides | {"turn": replace(turn, center=turn.center + jnp.array([0.1, -0.05]))})
    return _with_losses(scene, damped, friction)


def _with_losses(scene: Scene, damped: bool, friction: bool) -> Scene:
    paper, contact = scene.sheets["paper"], scene.contacts["default"]
    paper = replace(
        paper,
        structural_damping=paper.structural_damping * float(damped),
        friction_factor=paper.friction_factor * float(friction),
    )
    contact = replace(contact, damping=contact.damping * float(damped))
    return replace(scene, sheets={"paper": paper}, contacts=scene.contacts | {"default": contact})


def free(seed: int, damped: bool = True, gravity: bool = True) -> Scene:
    """The same sheet far from all guides, bent and whirling."""
    rng, scene = np.random.default_rng(seed), slider(seed, damped)
    paper = replace(
        scene.sheets["paper"],
        headings=jnp.asarray(np.cumsum(rng.uniform(-25.0, 25.0, 6))),
        rates=jnp.asarray(rng.uniform(-60.0, 60.0, 6)),
    )
    return replace(
        scene, sheets={"paper": paper}, guides=shifted(scene.guides, FAR), gravity=scene.gravity * float(gravity)
    )


def order(coarse: float, fine: float) -> float:
    """Order of convergence from the errors at two steps, one half of the other."""
    return float(np.log2(coarse / fine))


# --- reversal --------------------------------------------------------------------------------------------------------


def _there_and_back(scene: Scene, method: str, dt: float) -> float:
    """mm: run, turn all velocities round, run: distance of the nodes from where they started."""
    start = run(scene, method, duration=100 * dt, dt=dt)
    turned = _with_velocities(scene, start.states, -1)
    back = run(turned, method, duration=100 * dt, dt=dt)
    return float(jnp.max(jnp.abs(back.sheets["paper"].nodes[-1] - start.sheets["paper"].nodes[0])))


def _with_velocities(scene: Scene, states, frame: int) -> Scene:
    """The scene begun from a frame with its velocities turned round."""
    model = build(scene)
    state = jax.tree.map(lambda v: v[frame], states)
    at = jax.jit(lambda s: look(model, s)[0])(state)
    half = model.bars.half_length[0]
    ahead, aside = jnp.stack([at.c[0], at.s[0]]), jnp.stack([-at.s[0], at.c[0]])
    lead = jnp.stack([at.x[0], at.y[0]]) + half * ahead
    velocity = jnp.stack([at.vx[0], at.vy[0]]) + half * at.w[0] * aside
    paper = replace(
        scene.sheets["paper"], lead=lead, headings=jnp.rad2deg(state.heading), rates=-state.rate, velocity=-velocity
    )
    return replace(scene, sheets={"paper": paper})


# A reversible method would come back to rounding; an explicit one of order four loses O(dt^4 T), here at a step where
# that is below 1e-8 (free) and 1e-6 (contact, exponent 2).
@pytest.mark.long
@pytest.mark.parametrize("method", HIGH_ORDER)
@pytest.mark.parametrize("seed", SEEDS)
def test_time_runs_backwards_too(method, seed):
    assert _there_and_back(free(seed, damped=False), method, 1e-5) < 1e-8
    assert _there_and_back(slider(seed, damped=False, friction=False), method, 1e-5) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_the_midpoint_rule_comes_back_at_any_step(seed):
    """Time-reversible, as far as its Newton passes converge; at the same steps another method of order two is far off."""
    for scene, dt in ((free(seed, damped=False), 1e-4), (slider(seed, damped=False, friction=False), DT)):
        missed = {m: _there_and_back(scene, m, dt) for m in ("midpoint", "extrapolated_euler")}
        assert missed["midpoint"] < 1e-9
        assert missed["extrapolated_euler"] > 1e-5


@pytest.mark.long
@pytest.mark.parametrize("method", HIGH_ORDER)
def test_way_back_is_missed_by_the_order_of_the_method(method):
    scene = replace(free(0, damped=False), gravity=jnp.zeros(2))
    coarse, fine = (_there_and_back(scene, method, dt) for dt in (2e-4, 1e-4))
    assert order(coarse, 2.0 * fine) > ORDER[method] - 0.5  # half the step covers half the time


# --- momentum --------------------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", SEEDS)
def test_momentum_of_a_free_sheet(method, seed):
    _, still = every_step(free(seed, gravity=False), method)
    scale = float(jnp.max(jnp.abs(still.momentum)))
    assert np.max(np.abs(still.momentum - still.momentum[:1])) < 1e-12 * scale
    trajectory, falling = every_step(free(seed), method)
    momentum, weight = np.asarray(falling.momentum), np.asarray(falling.weight)
    expected = momentum[0] + np.asarray(trajectory.time)[:, None] * weight
    assert np.max(np.abs(momentum - expected)) < 1e-12 * np.max(np.abs(momentum))


def _momentum_gap(scene: Scene, method: str, dt: float) -> float:
    """Momentum less the integral of reported contact forces and weight over 2.5 ms, relative."""
    trajectory, book = every_step(scene, method, dt)
    end = round(2.5e-3 / dt)
    momentum = np.asarray(book.momentum)
    owed = integral(book.push + book.weight, trajectory.time)[end // 2]
    assert np.max(np.abs(book.push)) > 1.0
    return float(np.max(np.abs(momentum[end] - momentum[0] - owed)) / np.max(np.abs(momentum)))


@pytest.mark.parametrize("seed", SEEDS)
def test_momentum_comes_from_contact_forces_and_weight(seed):
    """The reported force is the law at the state. An implicit step feels the force at its end: equal to order one."""
    scene = slider(seed)
    for method in HIGH_ORDER:
        assert _momentum_gap(scene, method, DT / 4) < 1e-6  # Simpson's rule across the kinks of the ramp
    coarse, fine = (_momentum_gap(scene, "linear_euler", dt) for dt in (DT, DT / 4))
    assert coarse < 3e-3
    assert fine < 0.5 * coarse


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", SEEDS)
def test_rollers_feel_what_sheets_feel(method, seed):
    """Sprung rollers without springs, alone with the sheet in space, all moving in one direction: what the sheet loses
    along it the rollers gain, friction included, to rounding in every step."""
    scene = _floating(seed)
    book = ledger(scene, run(scene, method).states)
    total = np.asarray(book.momentum)[:, 1] + np.sum(np.asarray(book.travelling), axis=1)
    exchanged = np.ptp(np.asarray(book.momentum)[:, 1])
    assert exchanged > 0.01
    assert np.max(np.abs(total - total[0])) < 1e-12 * np.max(np.abs(book.momentum))


def _floating(seed: int) -> Scene:
    scene, up = nip(np.random.default_rng(seed)), jnp.array([0.0, 1.0])
    rollers = {name: scene.rollers[name] for name in scene.rollers}
    for name in ("pinch", "kicker", "rider"):
        zero = jnp.zeros(())
        rollers[name] = replace(
            rollers[name],
            direction=up,
            spring=zero,
            preload=zero,
            damper=zero,
            travel_min=zero - 1e3,
            travel_max=zero + 1e3,
        )
    for name in ("drive", "idle", "rider"):
        rollers[name] = shifted(rollers[name], FAR * (2.0 if name == "rider" else 1.0))
    return replace(scene, rollers=rollers, guides=shifted(scene.guides, FAR), gravity=jnp.zeros(2))


def _spin_drift(method: str, seed: int, dt: float) -> float:
    """Largest relative change of the angular momentum about the origin in 10 ms."""
    _, book = every_step(free(seed, gravity=False), method, dt)
    spin = np.asarray(book.spin)[: round(0.01 / dt) + 1]
    return float(np.max(np.abs(spin - spin[0])) / np.abs(spin[0]))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", SEEDS)
def test_angular_momentum_of_a_free_sheet(method, seed):
    """Joint dampers are internal: only the method's own error turns the sheet, and falls with its order."""
    coarse, fine = (_spin_drift(method, seed, dt) for dt in (1e-4, 5e-5))
    assert order(coarse, fine) > ORDER[method] - 0.4
    assert fine < {1: 1e-2, 2: 1e-3, 4: 1e-7}[ORDER[method]]


# --- energy ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", HIGH_ORDER)
@pytest.mark.parametrize("seed", SEEDS)
def test_energy_is_kept_without_losses(method, seed):
    for scene in (free(seed, damped=False), slider(seed, damped=False, friction=False)):
        _, book = every_step(scene, method, DT / 2)
        energy = np.asarray(book.energy)
        assert np.max(np.abs(energy - energy[0])) < 1e-6 * np.abs(energy[0])


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
def test_energy_error_falls_with_the_order(method):
    errors = []
    for dt in (1e-4, 5e-5):
        _, book = every_step(free(0, damped=False, gravity=False), method, dt)
        errors.append(abs(float(book.energy[round(0.01 / dt)] - book.energy[0])))
    # An implicit method of order one damps stiff bending so strongly that half the step halves only the rest.
    assert order(*errors) > ORDER[method] - (0.3 if ORDER[method] > 1 else 0.5)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("friction", [False, True], ids=["slick", "rough"])
@pytest.mark.parametrize("seed", SEEDS)
def test_energy_never_rises_between_fixed_guides(method, friction, seed):
    _, book = every_step(slider(seed, friction=friction), method)
    energy = np.asarray(book.energy)
    assert np.max(np.diff(energy)) < 1e-8 * np.abs(energy[0])
    assert energy[-1] < energy[0] * (1.0 - 1e-3)


def _imbalance(book: Ledger, dt: float, until: float = 2.5e-3) -> float:
    """Change of energy less the integral of drives minus losses, relative to the largest of these."""
    end = round(until / dt)
    time = dt * np.arange(STEPS + 1)
    energy, work = np.asarray(book.energy), integral(input_power(book), time)
    size = max(abs(integral(p, time)[end // 2]) for p in book.powers)
    return abs(float(energy[end] - energy[0] - work[end // 2])) / float(size)


@pytest.mark.parametrize("seed", SEEDS)
def test_losses_explain_the_energy(seed):
    """Friction, contact damping and joint damping add up, in contact and in flight."""
    for scene in (slider(seed), free(seed)):
        for method in HIGH_ORDER:
            assert _imbalance(every_step(scene, method, DT / 4)[1], DT / 4) < 1e-4
    coarse, fine = (_imbalance(every_step(free(seed), "linear_euler", dt)[1], dt) for dt in (DT, DT / 4))
    assert fine < 0.5 * coarse


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
def test_observed_energy_is_the_integral_of_the_powers(method):
    trajectory, book = every_step(slider(0), method)
    seen = dict(trajectory.observed["energy"])
    change = float(book.energy[-1] - book.energy[0])
    assert abs(float(seen.pop("stored")) - change) < 1e-12 * (1.0 + abs(change))
    for name, total in seen.items():
        expected = np.trapezoid(np.asarray(getattr(book.powers, name)), np.asarray(trajectory.time))
        assert abs(float(total) - expected) < 1e-12 * (1.0 + abs(expected))


def _motor_gap(seed: int, method: str, dt: float) -> float:
    # A stiff sheet: where a joint bends towards a roller both faces share its contact, in shares that move with it, and
    # the energy stored there changes by that without work (1e-3 of the drives' work in the soft sheet of this scene).
    scene = draw("nip", seed)
    scene = replace(scene, sheets={"paper": replace(scene.sheets["paper"], youngs_modulus=jnp.asarray(3e4))})
    states = run(scene, method, duration=STEPS * dt, dt=dt, frames=STEPS + 1).states
    return _imbalance(ledger(scene, states), dt)


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_motors_pay_for_energy_and_losses(seed):
    """1e-4 of the largest work at order four; a method of order one is as good as its step."""
    for method in HIGH_ORDER:
        assert _motor_gap(seed, method, DT / 4) < 1e-4
    coarse, fine = (_motor_gap(seed, "linear_euler", dt) for dt in (DT, DT / 4))
    assert fine < 0.5 * coarse


# --- rest ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_straight_sheet_at_rest_stays(method):
    scene = free(0, gravity=False)
    zero = jnp.zeros(6)
    paper = replace(scene.sheets["paper"], headings=zero + 33.0, rates=zero, velocity=jnp.zeros(2), curl=jnp.zeros(()))
    trajectory, _ = every_step(replace(scene, sheets={"paper": paper}), method)
    assert np.max(np.abs(trajectory.sheets["paper"].velocities)) < 1e-12


@pytest.mark.parametrize("method", METHODS)
def test_settled_sheet_stays(method):
    """A cantilever in its rest state moves by the rounding of that state only."""
    scene = draw("clamped", 0)
    still = replace(scene.clamps["wall"].motion, displacement=jnp.zeros((2, 2)), rotation=jnp.zeros(2))
    scene = replace(scene, clamps={"wall": replace(scene.clamps["wall"], motion=still)})
    state = jax.jit(diffeed.settle)(scene)
    track = run(scene, method, initial=state).sheets["strip"]
    fall = 9810.0 * 0.01
    assert np.max(np.abs(track.velocities)) < 1e-9 * fall


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
def test_symmetric_nips_do_not_buckle_a_straight_sheet(method):
    """The rear nip feeds faster than the front one: the sheet is pressed, and by symmetry stays in its line."""
    trajectory = run(squeeze(300.0, 100.0), method)
    nodes, push = trajectory.sheets["paper"].nodes, trajectory.sheets["paper"].push
    assert float(jnp.max(jnp.abs(push[..., 0]))) > 0.05
    assert float(jnp.max(jnp.abs(nodes[..., 1]))) < 1e-12
    assert float(jnp.max(jnp.abs(trajectory.sheets["paper"].headings))) < 1e-12


@jax.jit
def _linearise(scene: Scene) -> diffeed.Linearisation:
    return diffeed.linearise(scene, initial_state(build(scene), scene))


EULER_LOAD = np.pi**2 * 300.0 * 0.5**3 * 30.0 / 12.0 / 60.0**2
KICK = 1e-9


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
def test_kick_grows_above_the_euler_load_only(method):
    """Pressed between pins with 0.8 and 1.5 times the Euler load (0.5 mm bars' discretisation moves it by 2 %)."""
    rates = {}
    for share in (0.8, 1.5):
        scene = strut(share * EULER_LOAD, KICK)
        headings = run(scene, method, duration=200 * 5e-4, dt=5e-4, frames=201).sheets["paper"].headings
        rates[share] = np.max(np.abs(headings), axis=1)
    assert np.max(rates[0.8]) < 1e-9
    assert rates[1.5][-1] > 20.0 * np.max(rates[0.8])
    slowest = _linearise(strut(1.5 * EULER_LOAD, 0.0)).modes()[0][0]
    growth = np.log(rates[1.5][-1] / rates[1.5][-41]) / (40 * 5e-4)
    assert slowest < 0.0
    # The kick is the first mode: its exponential growth is that of the unstable mode. Order one at this step: 5 %.
    assert growth == pytest.approx(-slowest, rel={1: 0.05, 2: 5e-3, 4: 1e-3}[ORDER[method]])


# --- one bar ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", SEEDS)
def test_one_bar_is_a_rigid_rod(method, seed):
    """A parabola and a constant spin. A method of order one moves with the velocity at the end of each step and
    falls g dt t/2 further: that is its exact answer."""
    scene = rod(np.random.default_rng(seed))
    states = run(scene, method).states
    t = np.asarray(states.time)
    late = DT if ORDER[method] == 1 else 0.0
    for x, v, g in ((states.x, states.vx, scene.gravity[0]), (states.y, states.vy, scene.gravity[1])):
        x, v, g = np.asarray(x)[:, 0], np.asarray(v)[:, 0], float(g)
        assert np.max(np.abs(v - (v[0] + g * t))) < 1e-11 * 1e3
        assert np.max(np.abs(x - (x[0] + v[0] * t + 0.5 * g * t * (t + late)))) < 1e-11 * 100.0
    heading, rate = np.asarray(states.heading)[:, 0], np.asarray(states.rate)[:, 0]
    assert np.max(np.abs(rate - rate[0])) < 1e-11 * np.abs(rate[0])
    assert np.max(np.abs(heading - (heading[0] + rate[0] * t))) < 1e-11


# --- contact forces --------------------------------------------------------------------------------------------------


def _check_forces(surface: Surface, touch, gap, v_n, v_t, factor) -> None:
    """No adhesion, no force across a gap, friction within its cone and against the slip."""
    force, friction = np.asarray(touch.force), np.asarray(touch.friction)
    assert np.all(force >= 0.0)
    assert np.all(force[np.asarray(gap) >= 0.0] == 0.0)
    static = 1.0 + (0.0 if surface.static_excess is None else np.maximum(np.asarray(surface.static_excess), 0.0))
    cone = np.asarray(surface.friction) * static * np.asarray(factor) * force
    assert np.all(np.abs(friction) <= cone * (1.0 + 1e-15))
    assert np.all(friction * np.asarray(v_t) >= 0.0)  # `friction` is what opposes v_t


@pytest.mark.parametrize("law", ["sqrt", "tanh"])
@pytest.mark.parametrize("seed", SEEDS)
def test_contact_law_only_pushes(law, seed):
    rng, n = np.random.default_rng(seed), 2000
    positive = {
        name: np.exp(rng.uniform(*np.log(bounds), n))
        for name, bounds in {
            "friction": (0.01, 2.0), "stiffness": (1.0, 1e6), "exponent": (0.6, 3.0), "damping": (1e-3, 1e5),
            "damping_exponent": (0.3, 3.0), "smoothing": (1e-6, 0.1), "stick_speed": (1e-3, 100.0),
            "static_excess": (1e-3, 1.0), "transition_speed": (1.0, 100.0),
        }.items()
    }  # fmt: skip
    surface = Surface(
        **{k: jnp.asarray(v) for k, v in positive.items()}, tanh=jnp.full(n, True) if law == "tanh" else None
    )
    gap, v_n, v_t = (
        rng.uniform(-0.1, 0.05, n),
        rng.normal(0.0, 300.0, n),
        rng.normal(0.0, 100.0, n) * rng.integers(0, 2, n),
    )
    touch = contact_law(surface, jnp.asarray(-gap), jnp.asarray(v_n), jnp.asarray(v_t), 1.3)
    assert np.sum(np.asarray(touch.force) > 0) > n // 4
    assert np.sum((np.asarray(touch.force) == 0) & (gap < 0)) > n // 20, "the clip must act in some"
    _check_forces(surface, touch, gap, v_n, v_t, 1.3)


@pytest.mark.parametrize("structure", ["nip", "guided"])
@pytest.mark.parametrize("seed", SEEDS)
def test_reported_forces_only_push(structure, seed):
    """All pairs of scenes in motion, at their start and at random states near it."""
    scene = draw(structure, seed)
    touching, factor, surfaces = _contacts(scene, jax.random.key(seed))
    sheets, rollers = touching.sheets, touching.rollers
    assert float(jnp.max(sheets.touch.force)) > 0.01 * NEWTON
    _check_forces(surfaces[0], sheets.touch, sheets.gap, sheets.v_n, sheets.v_t, factor[None])
    if rollers is not None:
        assert float(jnp.max(rollers.touch.force)) > 0.0
        _check_forces(surfaces[1], rollers.touch, rollers.gap, rollers.v_n, rollers.v_t, 1.0)


@jax.jit
def _contacts(scene: Scene, key):
    """Contacts at a state near the start in which everything moves at random."""
    model = build(scene)
    state = initial_state(model, scene)
    keys = iter(jax.random.split(key, 8))

    def jolt(v, size):
        return v + size * jax.random.normal(next(keys), v.shape, v.dtype)

    state = replace(
        state, heading=jolt(state.heading, 1e-3), vx=jolt(state.vx, 100.0), vy=jolt(state.vy, 10.0),
        rate=jolt(state.rate, 5.0), travel_rate=jolt(state.travel_rate, 10.0), spin=jolt(state.spin, 10.0),
    )  # fmt: skip
    touching = look(model, state)[2]
    return (
        touching,
        features(model, look(model, state)[0])[0].own.friction_factor[0],
        (jax.tree.map(lambda v: v[:, None], model.surface), model.pair_surface),
    )
