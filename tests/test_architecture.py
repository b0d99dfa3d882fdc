"""The house plan: imports run one way, importing is light and changes nothing."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "diffeed"

RANKS = """
    base: words names record_html records files folders terminal toml_text limits one_kernel batching places smallest products
    base: factor sweeps smooth once angles
    abreast: values arrays loops walk
    tuning plot_style
    pair: shapes skin law rebound
    input: parts packing check_values check_rules check_records remarks_places remarks paths scene_file stacking
    schema
    model: layout arrays rows movements sheets rollers guides surfaces build
    chain: state system sums kinematics dense elimination solve
    contact: features profile movement bodies kept near sweep hits gained roller_pairs crossing stick watched candidates
    forces: terms sheet loads clamps contacts rollers assemble landing energy
    faults: causes tally balance overshoot rebounds judge
    steppers: advance astray linear_euler extrapolated_euler runge_kutta midpoint
    readings: trajectory snapshot spans pressed_guides observe frames margin gate why verdict agreement
    statics: coordinates relax rest vibrations
    run: progress error_control rollout joints examine pieces
    measures
    show: labels outlines player_data plot_machine
    plot player
    show: scene_html
    gradients: modes trust faults
    command: report outputs earlier session
    bench: settings timing machine outcome jaxprs pareto records front transport batch gradient point growth features ripple
    bench: roughness stability_scene stability stability_chart report charts files advise kinds figures together cli
    cli
    __main__
    __init__
"""
"""Modules by rank, lowest first, a package with what is in it; what a package itself says stands above its modules."""


def in_order() -> list[str]:
    found = []
    for line in RANKS.strip().splitlines():
        package, colon, inside = line.strip().partition(":")
        if colon:
            found = [name for name in found if name != package]  # a package may have two lines: the second ends it
            found += [*(f"{package}.{name}" for name in inside.split()), package]
        else:
            found += line.split()
    return found


ORDER = in_order()


def modules() -> dict[str, Path]:
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        name = ".".join(p for p in parts if p != "__init__") or "__init__"
        found[name] = path
    return found


def imported(path: Path) -> set[str]:
    """Modules of the package that a file imports, wherever in the file it does so."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "diffeed":
            inner = node.module.removeprefix("diffeed").lstrip(".")
            for alias in node.names:
                deeper = f"{inner}.{alias.name}".lstrip(".")
                found.add(deeper if deeper in modules() else inner or "__init__")
        elif isinstance(node, ast.Import):
            found |= {a.name.removeprefix("diffeed.") for a in node.names if a.name.startswith("diffeed.")}
    return found


def test_every_module_has_a_rank():
    assert set(modules()) <= set(ORDER), "give each new module a place in RANKS"


@pytest.mark.parametrize("name", sorted(modules()))
def test_imports_run_one_way(name):
    own = ORDER.index(name)
    above = {m for m in imported(modules()[name]) if ORDER.index(m) >= own}
    assert not above, f"diffeed.{name} imports {above}, which stand above it"


def test_the_simulator_knows_no_optimiser():
    assert not [p for p in PACKAGE.rglob("*.py") if "optax" in p.read_text() or "import optimize" in p.read_text()]


def test_physics_imports_no_file_format_and_no_picture():
    physics = ORDER[ORDER.index("model.layout") : ORDER.index("measures") + 1]
    banned = {"input.scene_file", "plot", "player", "cli", "tomllib", "matplotlib"}
    for name in physics:
        names = {
            a.name.split(".")[0]
            for node in ast.walk(ast.parse(modules()[name].read_text()))
            if isinstance(node, (ast.Import, ast.ImportFrom))
            for a in node.names
        }
        assert not (imported(modules()[name]) | names) & banned, name


def test_importing_changes_nothing():
    code = """
import os, sys, jax
before = (dict(os.environ), jax.config.jax_enable_x64, jax.config.jax_compilation_cache_dir)
import diffeed
diffeed.simulate, diffeed.load_scene, diffeed.measures
assert (dict(os.environ), jax.config.jax_enable_x64, jax.config.jax_compilation_cache_dir) == before
assert "matplotlib" not in sys.modules and "optax" not in sys.modules
assert not jax._src.xla_bridge._backends, "importing started a backend"
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def test_the_simulator_knows_nothing_of_the_design_loop():
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text()
        assert "import optax" not in text, path
        assert "optimize" not in {n.split(".")[0] for n in re.findall(r"^\s*(?:from|import) (\S+)", text, re.M)}, path


def test_the_design_loop_uses_public_names_of_the_simulator():
    """Its top names, and the modules that `diffeed` offers beside them."""
    import diffeed

    offered = {"measures", "plot", "player", "tuning", "schema", "plot_style", "run.rollout"}
    offered |= {"abreast", "faults.causes", "readings.agreement", "readings.trajectory", "input.stacking"}
    for path in (PACKAGE.parent / "optimize").rglob("*.py"):
        modules_asked = {name for name in imported(path) - {"__init__"} if not name.startswith("base.")}
        top = {
            alias.name
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.ImportFrom) and node.module == "diffeed"
            for alias in node.names
        }
        beside = (modules_asked | top - set(diffeed.__all__)) - offered
        assert not beside, (path, beside)


def test_no_module_hides_a_public_name():
    """A submodule becomes an attribute of its package when anything imports it: it must not be called as a function is."""
    import optimize

    modules = {p.stem for p in (PACKAGE.parent / "optimize").iterdir()} - {"__init__", "__main__"}
    assert not modules & set(optimize.__all__)
    import diffeed

    hidden = {p.stem for p in PACKAGE.iterdir()} & set(diffeed.__all__)
    assert hidden <= {"measures"}  # the module itself is what is offered
