"""Compiler settings of the command line: set where nothing else was asked for, and only where they are known."""

import gc
import os
import subprocess
import sys

import pytest

from diffeed import tuning

SUMS = "--xla_cpu_experimental_ynn_fusion_type="


@pytest.fixture
def flags(monkeypatch):
    """The flags after a call, from those given before; nothing is compiled here."""

    def after(call, given, version="0.10.2"):
        monkeypatch.setenv("XLA_FLAGS", given)
        monkeypatch.setattr(tuning, "version", lambda name: version)
        call()
        return os.environ["XLA_FLAGS"].split()

    return after


def test_flags_are_added_to_those_given(flags):
    quick = ["--xla_cpu_use_fusion_emitters=false", "--xla_backend_extra_options=xla_cpu_disable_loop_unrolling"]
    whole = "xla_cpu_small_while_loop_byte_threshold=1000000000"
    assert flags(tuning.compile_quickly, "--xla_foo=1") == ["--xla_foo=1", *quick]
    assert flags(tuning.compile_for_speed, "") == [quick[0], f"{quick[1]},{whole}", SUMS]
    wide = ["--xla_cpu_prefer_vector_width=512", "--xla_cpu_enable_concurrency_optimized_scheduler=false"]
    wide += ["--xla_cpu_copy_insertion_use_region_analysis=true"]
    assert flags(tuning.compile_for_many, "") == [quick[0], f"{quick[1]},{whole}", SUMS, *wide]
    assert flags(tuning.compile_for_batches, "") == quick[1:]
    assert flags(tuning.fuse_outputs, "") == [quick[0], quick[1] + ",xla_cpu_use_multi_output_fusion"]


def test_what_the_user_set_stays(flags):
    emitters, extra = "--xla_cpu_use_fusion_emitters=true", "--xla_backend_extra_options=xla_foo"
    for call, more in ((tuning.compile_quickly, []), (tuning.compile_for_speed, [SUMS]), (tuning.fuse_outputs, [])):
        assert flags(call, f"{emitters} {extra}") == [emitters, extra, *more]
        assert flags(call, extra) == [extra, "--xla_cpu_use_fusion_emitters=false", *more]
    assert flags(tuning.compile_for_speed, f"{emitters} {extra} {SUMS}dot") == [emitters, extra, f"{SUMS}dot"]


@pytest.mark.parametrize(("before", "after"), [(700, tuning.GARBAGE), (10**6, 10**6), (0, 0)])
def test_python_looks_for_garbage_less_often_unless_told_otherwise(flags, before, after):
    kept = gc.get_threshold()
    try:
        gc.set_threshold(before, 7, 9)
        flags(tuning.compile_quickly, "")
        assert gc.get_threshold() == (after, 7, 9)
    finally:
        gc.set_threshold(*kept)


@pytest.mark.parametrize(("version", "count"), [("0.10.2", 2), ("0.11.2", 0), ("0.12.0.1", 1), ("0.13.0", 0)])
def test_a_compiler_that_is_known_to_fuse_does_so_unasked_for_batches(flags, version, count):
    assert len(flags(tuning.compile_quickly, "", version)) == count
    batches = flags(tuning.compile_for_batches, "", version)
    assert (batches == flags(tuning.fuse_outputs, "", version)) == (version != "0.10.2")


@pytest.mark.parametrize(("version", "count"), [("0.10.2", 2), ("0.11.2", 0), ("0.12.0.1", 1), ("1.0.0rc1", 0)])
def test_a_compiler_gets_no_flags_that_it_may_not_know(flags, version, count):
    assert len(flags(tuning.fuse_outputs, "", version)) == count


@pytest.mark.parametrize(("alone", "given", "found"), [(True, "", "1"), (False, "", "unset"), (True, "3", "3")])
def test_a_command_for_single_runs_takes_one_core_unless_told_otherwise(alone, given, found):
    set_up = f"from diffeed.command.session import set_up; set_up(alone={alone})"
    code = f"import os; {set_up}; print(os.environ.get('NPROC', 'unset'))"
    env = {k: v for k, v in os.environ.items() if k != "NPROC"} | ({"NPROC": given} if given else {})
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, env=env)
    assert done.stdout.strip() == found, done.stderr


def test_the_flags_are_known_to_this_compiler():
    """It ends the process otherwise."""
    for call in ("compile_quickly", "compile_for_speed", "compile_for_batches", "fuse_outputs", "compile_plainly"):
        code = f"from diffeed import tuning; tuning.{call}(); import jax; print(jax.numpy.ones(2).sum())"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
        assert done.stdout.strip() == "2.0", done.stderr
