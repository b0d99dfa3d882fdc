"""Folders of results: one writer, whole files, drafts that are known and removed, plain sentences for a disk that will not."""

import contextlib
import dataclasses
import errno
import os
import subprocess
import sys
from pathlib import Path

import jax
import pytest
from click.testing import CliRunner
from test_cli import MINI, command
from test_optimize_cli import STUDY
from test_optimize_cli import run as optimise

import diffeed
from diffeed.base.files import replacing, write_whole
from diffeed.base.folders import Lock, OutputError, draft_of, holding, publishing, write_all
from optimize.cli import main
from optimize.journal import Journal, JournalError
from optimize.problem import make_problem
from optimize.study import Study
from optimize.tolerance.folder import Folder, FolderError

FILES = ("a.txt", "last.txt")
WRITERS = {name: lambda path: path.write_text("new") for name in FILES}
ROOT = Path(__file__).parent.parent
HOLD = """
import sys, time
from pathlib import Path
from diffeed.base.folders import draft_of
with draft_of(Path(sys.argv[1])) as draft:
    (draft / "a.txt").write_text("half")
    print("holding", flush=True)
    time.sleep(600)
"""


@contextlib.contextmanager
def another_process(folder: Path):
    """Another run with a draft of the folder."""
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(folder)], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    assert process.stdout
    assert process.stdout.readline() == "holding\n"
    try:
        yield process
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def listed(folder: Path) -> dict[str, str]:
    return {str(p.relative_to(folder)): p.read_text() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize("there", [False, True])
def test_while_one_run_writes_another_is_refused_and_a_dead_one_is_cleared_away(tmp_path, there):
    out = tmp_path / "out"
    if there:
        out.mkdir()
        (out / "notes.txt").write_text("mine")
    before = listed(out)
    with another_process(out):
        (draft,) = [name for name in listed(tmp_path) if name.endswith("a.txt")]
        assert draft == ("out/.part/a.txt" if there else ".out.part/a.txt")
        with pytest.raises(OutputError, match=r"out is being written by another run; wait for its end, or name"):
            draft_of(out, FILES).__enter__()
        assert draft in listed(tmp_path), "the draft of a run that lives was removed"
    assert draft in listed(tmp_path)  # the kill left it
    with draft_of(out, FILES) as mine:
        assert list(mine.iterdir()) == []
        write_all(mine, out, WRITERS, FILES)
    assert listed(tmp_path) == {f"out/{name}": text for name, text in (before | dict.fromkeys(FILES, "new")).items()}


def test_nothing_is_overwritten_that_came_while_the_run_went_on(tmp_path):
    out = tmp_path / "out"
    with draft_of(out, FILES) as draft:
        out.mkdir()
        (out / "a.txt").write_text("precious")
        said = r"already holds a.txt \(of a run that was stopped while it wrote: last.txt is missing\)"
        with pytest.raises(OutputError, match=said):
            write_all(draft, out, WRITERS, FILES)
    assert listed(tmp_path) == {"out/a.txt": "precious"}


def test_a_run_that_ends_does_not_remove_the_draft_of_the_next(tmp_path):
    out = tmp_path / "out"
    with draft_of(out, FILES) as draft:
        write_all(draft, out, WRITERS, FILES)
        draft.mkdir()
        (draft / "other.txt").write_text("of another run")
    assert (draft / "other.txt").exists()


def test_an_error_leaves_no_draft_and_the_old_files(tmp_path):
    out = tmp_path / "out"
    with publishing(out, FILES, force=False) as draft:
        for name, write in WRITERS.items():
            write(draft / name)
    with contextlib.suppress(ZeroDivisionError), publishing(out, FILES, force=True) as draft:
        (draft / "a.txt").write_text("newer")
        raise ZeroDivisionError
    assert listed(tmp_path) == {"out/a.txt": "new", "out/last.txt": "new"}
    with publishing(None, FILES, force=False) as draft:
        assert draft is None


def test_without_locks_drafts_have_names_of_their_own(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "fcntl", None)
    out = tmp_path / "out"
    for _ in range(2):  # beside, then inside
        with draft_of(out) as one, draft_of(out) as two:
            assert one != two
        with draft_of(out) as draft:
            write_all(draft, out, WRITERS, FILES)
        write_whole(out / "x.txt", "y")
    assert listed(tmp_path) == {"out/a.txt": "new", "out/last.txt": "new", "out/x.txt": "y"}


def test_a_command_holds_its_folder_and_leaves_no_empty_one(tmp_path):
    with holding(tmp_path / "out"):
        assert Lock(tmp_path / "out").descriptor is None  # parts of the command may write
        with pytest.raises(OutputError, match="being written by another run"):
            subprocess_lock(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []
    with holding(None):
        pass


def subprocess_lock(folder: Path) -> None:
    code = "import sys; from pathlib import Path; from diffeed.base.folders import Lock; Lock(Path(sys.argv[1]))"
    done = subprocess.run([sys.executable, "-c", code, str(folder)], cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        raise OutputError(done.stderr.splitlines()[-1])


# --- one file -------------------------------------------------------------------------------------------------------------


def test_the_draft_of_a_killed_process_is_used_again(tmp_path):
    (tmp_path / ".x.txt.part").write_text("half of a long text")
    write_whole(tmp_path / "x.txt", "new")
    assert listed(tmp_path) == {"x.txt": "new"}


def test_two_writers_of_one_file_have_drafts_of_their_own(tmp_path):
    with replacing(tmp_path / "x.txt") as one:
        one.write(b"one")
        write_whole(tmp_path / "x.txt", "two")
        assert (tmp_path / "x.txt").read_text() == "two"
    assert listed(tmp_path) == {"x.txt": "one"}


def test_a_draft_that_is_a_link_is_not_followed(tmp_path):
    (tmp_path / "precious").write_text("mine")
    (tmp_path / ".x.txt.part").symlink_to(tmp_path / "precious")
    write_whole(tmp_path / "x.txt", "new")
    assert (tmp_path / "precious").read_text() == "mine"
    assert (tmp_path / "x.txt").read_text() == "new"


# --- disks ----------------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def disk(place: Path, options: str):
    """A file system of its own; only root may make one."""
    place.mkdir(exist_ok=True)
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(place)], capture_output=True, check=False
    )
    if done.returncode:
        pytest.skip("a file system can be mounted by root only")
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", str(place)], check=True)


@pytest.fixture
def full(tmp_path):
    """A disk with room for a few files of one page."""
    with disk(tmp_path / "disk", "size=64k") as place:
        (place / "filler").write_bytes(b"x" * (48 << 10))
        yield place


def test_a_full_disk_is_told_in_one_sentence_and_nothing_is_left(full):
    big = {"a.txt": lambda path: path.write_bytes(b"x" * 100_000), "last.txt": lambda path: path.write_text("x")}
    with pytest.raises(OutputError, match=r"the results were not written to .*: No space left on device$"), draft_of(
        full / "out"
    ) as draft:  # fmt: skip
        write_all(draft, full / "out", big, FILES)
    write_whole(full / "x.txt", "old")
    with pytest.raises(OSError, match="No space left"):
        write_whole(full / "x.txt", "y" * 100_000)
    assert listed(full).keys() == {"filler", "x.txt"}
    assert (full / "x.txt").read_text() == "old"


def test_a_read_only_disk_is_told_before_the_run(tmp_path):
    with disk(tmp_path / "disk", "ro,size=64k") as place:
        for out in (place, place / "new" / "out"):
            with pytest.raises(OutputError, match=r"cannot write to .*: Read-only file system$"):
                draft_of(out).__enter__()
        with pytest.raises(OutputError, match=r"cannot write to .*: Read-only file system$"):
            holding(place / "out").__enter__()
        with pytest.raises(FolderError, match=r"cannot write to .*: Read-only file system$"):
            Folder(place / "out", None).start(resume=False, force=True)  # type: ignore[arg-type]
        study = Path(__file__).parent / "search" / "strip.toml"
        done = CliRunner().invoke(main, ["design", str(study), "--out", str(place / "out")])
        assert "Traceback" not in done.output


def test_results_go_to_a_folder_on_another_disk(tmp_path):
    """A draft beside it could not be moved there."""
    with disk(tmp_path / "disk", "size=64k") as place:
        with draft_of(place) as draft:
            write_all(draft, place, WRITERS, FILES)
        assert listed(place) == dict.fromkeys(FILES, "new")


# --- searches and studies ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def problem():
    from stand_in_nip import nip

    table = {
        "scene": "nip", "duration": 0.01, "frames": 5,
        "variables": {"preload": {"path": "rollers.pinch.preload", "bounds": [1.0, 6.0]}},
        "objective": {"force": {"measure": "nip_force", "of": "pinch", "target": 4.0}},
    }  # fmt: skip
    return make_problem(Study.model_validate(table), scene=nip())


def test_a_search_stopped_in_its_first_iteration_can_be_resumed(tmp_path, problem):
    first = Journal(tmp_path / "out", problem)
    first.start(resume=False, force=False)
    first.close()
    with pytest.raises(JournalError, match="already holds a search; add --resume"):
        Journal(tmp_path / "out", problem).start(resume=False, force=False)
    again = Journal(tmp_path / "out", problem)
    assert again.start(resume=True, force=False).iteration == 0
    with pytest.raises(JournalError, match="is being written by another run"):
        Journal(tmp_path / "out", problem).start(resume=True, force=False)
    again.close()


def test_a_search_does_not_replace_what_a_run_wrote(tmp_path, problem):
    """The scene of a run and the result of a tolerance study have the names of those of a search."""
    for name in ("scene.toml", "result.json"):
        folder = tmp_path / name.split(".")[0]
        folder.mkdir()
        (folder / name).write_text("of a run")
        with pytest.raises(JournalError, match=f"already holds {name}; name another folder, or add --force"):
            Journal(folder, problem).start(resume=False, force=False)
        assert [p.name for p in folder.iterdir()] == [name]
        assert (folder / name).read_text() == "of a run"


def test_a_summary_goes_before_a_search_goes_on(tmp_path, problem):
    """Otherwise a folder would look complete while what it holds is being replaced."""
    (tmp_path / "result.json").write_text("of an earlier search")
    kept = Journal(tmp_path, problem)
    kept.start(resume=False, force=True)
    kept.close()
    assert not (tmp_path / "result.json").exists()


@pytest.mark.long
def test_a_search_that_ended_before_its_result_was_written_is_not_searched_on(tmp_path, problem):
    """Found by the killer: an iteration more, and another result. New budgets ask for more, and only they."""
    from optimize import descent

    short = dataclasses.replace(
        problem,
        study=problem.study.model_copy(update={"search": problem.study.search.model_copy(update={"iterations": 1})}),
    )
    kept = Journal(tmp_path, short)
    with jax.numpy_dtype_promotion("standard"):  # optax counts steps in whole numbers
        assert len(list(descent.search(short, kept.start(resume=False, force=False), kept.save))) == 1
    kept.close()

    def reason(asked):
        again = Journal(tmp_path, asked)
        found = again.start(resume=True, force=False)
        again.close()
        assert found.iteration == 1
        return found.reason

    assert reason(short) == "1 iterations are done"
    assert reason(problem) == ""
    (tmp_path / "result.json").write_text("{}")
    assert reason(short) == "1 iterations are done"


def test_a_full_disk_ends_a_search_with_one_sentence(tmp_path, problem, monkeypatch):
    from optimize import descent, journal

    kept = Journal(tmp_path, problem)
    progress = kept.start(resume=False, force=False)

    def fill(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(journal.np, "savez", fill)
    line = descent.Line(1, 0, 0, 1.0, 0.0, 1.0, 1.0, 1, 1, 1, 0.1, {"preload": 3.0})
    with pytest.raises(
        JournalError, match=r"could not be written to .*; --resume goes on .*: No space left on device$"
    ):
        kept.save(progress, line)
    kept.close()
    assert not list(tmp_path.glob(".*")), "a draft was left"


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a device that is always full")
def test_closing_on_a_full_disk_is_quiet(tmp_path, problem):
    kept = Journal(tmp_path, problem)
    kept.start(resume=False, force=False)
    kept._lines.close()
    kept._lines = open("/dev/full", "w")  # noqa: SIM115
    kept._lines.write("x")
    kept.close()


@pytest.mark.slow
def test_two_runs_into_one_folder_at_once(tmp_path):
    """Real processes: one writes all its files, the other says one sentence."""
    (tmp_path / "mini.toml").write_text(MINI)
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(2) as both:
        done = list(
            both.map(lambda _: command(tmp_path, "run", "mini.toml", "--frames", "3", "--out", "out"), range(2))
        )
    assert sorted(d.returncode for d in done) == [0, 2]
    lost = next(d for d in done if d.returncode)
    assert "Traceback" not in lost.stderr
    assert "being written by another run" in lost.stderr or "already holds" in lost.stderr
    assert (tmp_path / "out" / "summary.json").exists()
    assert not list(tmp_path.rglob("*.part"))


@pytest.mark.slow
def test_two_searches_into_one_folder_at_once(tmp_path):
    from concurrent.futures import ThreadPoolExecutor

    from stand_in_nip import nip

    diffeed.save_scene(nip(), tmp_path / "nip.toml")
    (tmp_path / "study.toml").write_text(STUDY)
    words = ("design", "study.toml", "--no-pictures", "--out", "out")
    with ThreadPoolExecutor(2) as both:
        done = list(both.map(lambda _: optimise(tmp_path, *words), range(2)))
    assert sorted(d.returncode for d in done) == [0, 2], [d.stderr for d in done]
    lost = next(d for d in done if d.returncode)
    assert "Traceback" not in lost.stderr
    assert "being written by another run" in lost.stderr or "already holds a search" in lost.stderr
    assert len((tmp_path / "out" / "history.jsonl").read_text().splitlines()) == 6
