"""The documentation: whole, true to the code, built without a warning; and each block of code on it runs.

The slow tests build the pages and run them; what is run of a page, `run_page.py` says.
"""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections import Counter
from pathlib import Path

import click
import pytest
from run_page import blocks, files, shell

import diffeed
import diffeed.cli
import optimize
import optimize.cli
from diffeed import measures
from diffeed.base.records import fields
from diffeed.faults.causes import CAUSES, REMEDIES
from diffeed.input.parts import SECTIONS, Motion, Profile, Scene
from optimize.study import Study
from optimize.study_file import is_tolerance
from optimize.terms import TERMS
from optimize.tolerance.problem import load_tolerance
from optimize.tolerance.records import ToleranceStudy

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = sorted(p for p in DOCS.rglob("*.md") if "_build" not in p.parts)
LANGUAGES = {"python", "check", "sh", "toml", "text", "diff"}
DIRECTIVES = {"{toctree}", "{eval-rst}", "{include}", "{literalinclude}"}
PATCHED = [p for p in PAGES if any(b.kind == "diff" for b in blocks(p))]


@pytest.fixture(scope="module")
def generated():
    sys.path.insert(0, str(DOCS))
    try:
        import generated

        return generated
    finally:
        sys.path.remove(str(DOCS))


def name(page: Path) -> str:
    return page.relative_to(DOCS).with_suffix("").as_posix()


# --- what is on the pages -------------------------------------------------------------------------------------------------


def test_every_page_is_in_the_table_of_contents_once():
    listed = [line for b in blocks(DOCS / "index.md") if b.kind == "{toctree}" for line in b.text.split()]
    assert Counter(listed) == Counter(name(p) for p in PAGES if name(p) != "index")


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_blocks_are_of_kinds_that_the_tests_know(page):
    """A block in a language that nobody runs would rot."""
    assert {b.kind for b in blocks(page)} <= LANGUAGES | DIRECTIVES
    text = page.read_text("utf-8")
    assert text.count("```") % 2 == 0
    assert not re.search(r"^(~~~| +```|````)", text, re.M), "blocks that the runner would not see"


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_python_is_python(page):
    for block in blocks(page):
        if block.kind in ("python", "check"):
            compile("\n" * (block.line - 1) + block.text, str(page), "exec")


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_code_is_as_wide_as_the_page(page):
    """Longer lines hide behind a scroll bar; a patch is as wide as the source."""
    for block in blocks(page):
        if block.kind in ("python", "sh", "toml", "text"):
            assert all(len(line) <= 92 for line in block.text.splitlines()), block.text
    for text in files(page).values():
        assert all(len(line) <= 92 for line in text.splitlines()), text


def test_figures_of_the_trade_are_those_of_the_readme():
    """Its tables are the README's own; what is told beside them must not be another's."""
    known = set(re.findall(r"\d+(?:[.,]\d+)*(?:e-?\d+)?", (ROOT / "README.md").read_text("utf-8")))
    page = re.sub(r"```.*?```|`[^`]*`", "", (DOCS / "trade.md").read_text("utf-8"), flags=re.S)
    told = set(re.findall(r"\d+(?:[.,]\d+)*(?:e-?\d+)?", page))
    assert told
    assert told <= known, told - known


@pytest.mark.parametrize("page", [p for p in PAGES if p not in PATCHED], ids=name)
def test_toml_is_read(page, tmp_path, monkeypatch):
    """Every TOML block is a file with a name, and a scene or study without a problem."""
    shown = [b for b in blocks(page) if b.kind == "toml"]
    assert all("caption" in b.options for b in shown)
    monkeypatch.chdir(tmp_path)
    for file, text in files(page).items():
        Path(file).write_text(text, "utf-8")
    for file, text in files(page).items():
        table = tomllib.loads(text)
        if "scene" not in table:
            assert diffeed.load_scene(file).sheets
        elif is_tolerance(table):
            assert load_tolerance(file).inputs
        else:
            assert optimize.load_study(file).variables


def rows(text: str) -> set[str]:
    """First cells of the rows of tables, as code."""
    return set(re.findall(r"^\| `([^`]+)` \|", text, re.M))


def test_every_field_of_a_scene_has_a_row(generated):
    kinds = [Scene, Profile, Motion, *(kind for kinds in SECTIONS.values() for kind in kinds.values())]
    sections = dict(re.findall(r"^### (.*?)\n(.*?)(?=^### |\Z)", generated.scene_fields(), re.M | re.S))
    assert len(sections) == len(kinds)
    for kind in kinds:
        text = sections["The scene itself" if kind is Scene else kind.__name__]
        assert rows(text) == {f.name for f in fields(kind)}
        for f in fields(kind):
            row = next(line for line in text.splitlines() if line.startswith(f"| `{f.name}` |"))
            assert f.metadata["doc"][1:].replace("|", "\\|") in row
            if f.metadata["role"] == "number" and f.metadata["unit"] not in ("1", "that of the field"):
                assert f.metadata["unit"] in row
            for choice in f.metadata.get("choices", ()):
                assert f'`"{choice}"`' in row


@pytest.mark.parametrize(("study", "part"), [(Study, "design_fields"), (ToleranceStudy, "tolerance_fields")])
def test_every_field_of_a_study_has_a_row(generated, study, part):
    """Also of the records in it, and each with a meaning."""
    text = generated.PARTS[part]()
    sections = re.findall(r"^### (.*?)\n(.*?)(?=^### |\Z)", text, re.M | re.S)
    assert rows(sections[0][1]) == set(study.model_fields)
    for title, section in sections[1:]:
        record = next(k for k in generated_kinds(study) if k.__name__ == title.split()[0])
        assert rows(section) == set(record.model_fields)
    for line in text.splitlines():
        if line.startswith("| `"):
            assert not line.endswith("|  |"), line


def generated_kinds(study) -> list[type]:
    import optimize.study
    import optimize.tolerance.records

    held = vars(optimize.study) | vars(optimize.tolerance.records)
    return [v for v in held.values() if isinstance(v, type) and hasattr(v, "model_fields")]


def test_terms_causes_and_sizes_are_all_told(generated):
    assert rows(generated.terms()) == set(TERMS)
    told = generated.causes()
    for cause, remedy in zip(CAUSES[1:], REMEDIES[1:], strict=True):
        assert f"| {cause[0].upper() + cause[1:]} | {remedy[0].upper() + remedy[1:]} |" in told
    from diffeed.forces.energy import Powers

    assert set(generated.POWERS) == set(Powers._fields)
    assert all(f"`{name}`" in generated.observed() for name in diffeed.OBSERVERS)
    from diffeed.base import limits

    assert rows(generated.sizes()) == {n for n in vars(limits) if n.isupper()}


def test_every_command_and_option_is_told(generated):
    text = generated.commands()

    def walk(path: str, command: click.Command) -> None:
        assert f"# {path}\n" in text
        section = text.split(f"# {path}\n")[1].split("\n## ")[0].split("\n### ")[0]
        for parameter in command.params:
            if isinstance(parameter, click.Option):
                assert parameter.opts[-1] in section, (path, parameter.opts)
        if isinstance(command, click.Group):
            for word, inner in command.commands.items():
                walk(f"{path} {word}", inner)

    walk("diffeed", diffeed.cli.main)
    walk("python -m optimize", optimize.cli.main)


def test_every_public_name_is_in_the_reference():
    text = (DOCS / "reference.md").read_text("utf-8")
    documented = set(re.findall(r"^\.\. auto(?:function|class|exception):: (\S+)", text, re.M))
    words = {"CAUSES", "METHODS", "OBSERVERS", "TERMS", "measures"}
    assert set(diffeed.__all__) | set(optimize.__all__) <= documented | words
    from diffeed import player, plot, tuning

    for module, homes in (
        (measures, ("measures", "margin", "verdict")),
        (plot, ("plot",)),
        (player, ("player",)),
        (tuning, ("tuning",)),
    ):
        section = text.split(f"## {module.__name__}\n")[1].split("\n## ")[0]
        offered = {
            n
            for n, v in vars(module).items()
            if not n.startswith("_") and callable(v) and getattr(v, "__module__", "") in {f"diffeed.{h}" for h in homes}
        }
        missing = offered - set(re.findall(r"^\.\. auto(?:function|class):: (\S+)", section, re.M))
        assert missing <= {"safe_devices"}, missing  # for the library's own loops over devices


# --- built and run ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_pages_are_built_without_a_warning_and_load_nothing_from_elsewhere(tmp_path):
    built = tmp_path / "built"
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-n", "-d", str(tmp_path / "trees"), "docs"]
    done = subprocess.run([*command, str(built)], cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    for page in PAGES:
        html = (built / name(page)).with_suffix(".html").read_text("utf-8")
        assert not re.findall(r"""<(?:script|link|img|iframe)[^>]+(?:src|href)=["'](?:https?:)?//""", html), page
        assert "<!-- generated" not in html
    assert (built / "model.html").read_text("utf-8").count("<math") > 20


@pytest.mark.slow
@pytest.mark.parametrize("page", [p for p in PAGES if any(b.kind in ("python", "sh") for b in blocks(p))], ids=name)
def test_the_code_of_a_page_runs(page, tmp_path):
    """In an empty folder. Where a page shows a patch, in a copy of the package to which it was applied."""
    here = tmp_path / "here"
    here.mkdir()
    path = str(ROOT)
    if page in PATCHED:
        path = str(tmp_path / "patched")
        for package in ("diffeed", "optimize"):
            shutil.copytree(ROOT / package, Path(path) / package, ignore=shutil.ignore_patterns("__pycache__"))
        patch = "".join(b.text for b in blocks(page) if b.kind == "diff")
        subprocess.run(["git", "init", "-q"], cwd=path, check=True)
        subprocess.run(["git", "apply", "-"], cwd=path, input=patch, text=True, check=True)
    given = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "JAX_ENABLE_X64")}
    done = subprocess.run(
        [sys.executable, str(ROOT / "tests" / "run_page.py"), str(page)], cwd=here, capture_output=True, text=True,
        timeout=900, env=given | {"PYTHONPATH": path, "XDG_CACHE_HOME": str(tmp_path / "cache"), "MPLBACKEND": "Agg"},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    assert "XLA" not in done.stderr, done.stderr[-4000:]


# --- the runner itself ----------------------------------------------------------------------------------------------------


def test_the_runner_runs_all_kinds_in_order_and_stops_at_an_error(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "# Page\n\n```{code-block} toml\n:caption: a.toml\n\nx = 1\n```\n\n```python\nimport tomllib\n\n"
        'found = tomllib.load(open("a.toml", "rb"))\nopen("b", "w").write("2")\n```\n\n% assert found == {"x": 1}\n\n'
        "```sh\npip install nothing-of-the-kind\ncat b > c\n```\n\n```python\nassert open('c').read() == '3'\n```\n"
    )
    done = subprocess.run(
        [sys.executable, ROOT / "tests" / "run_page.py", page], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 1
    assert 'page.md", line 24' in done.stderr
    assert (tmp_path / "c").read_text() == "2"
    assert shell("pip install x\nls") == "ls"
    page.write_text(page.read_text().replace("'3'", "'2'"))
    subprocess.run([sys.executable, ROOT / "tests" / "run_page.py", page], cwd=tmp_path, check=True)
    for failing in ("cat not-there", "cat not-there | cat", "false\ntrue"):
        page.write_text(f"```sh\n{failing}\n```\n")
        command = [sys.executable, ROOT / "tests" / "run_page.py", page]
        assert subprocess.run(command, cwd=tmp_path, capture_output=True).returncode == 1, failing
