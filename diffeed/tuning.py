"""Compiler settings for a whole program, such as the command line; a library leaves them to its user."""

import gc
import os
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

from diffeed.base.one_kernel import THRESHOLD

Version = tuple[int, int]
Flags = tuple[tuple[str, str], ...]
EXTRA = "xla_backend_extra_options"
NO_EMITTERS: Flags = (("xla_cpu_use_fusion_emitters", "false"),)
NO_UNROLLING: Flags = ((EXTRA, "xla_cpu_disable_loop_unrolling"),)
WHOLE: Flags = (
    (EXTRA, f"{THRESHOLD}=1000000000"),
    ("xla_cpu_experimental_ynn_fusion_type", ""),  # a library's sums, which no such kernel can call
)
"""One kernel of a whole run, however long its arrays are: a run takes a third to a half of the time, and twice as long to compile
(`diffeed.base.one_kernel`, `python -m tests.one_kernel_cost`)."""
WIDE: Flags = (
    ("xla_cpu_prefer_vector_width", "512"),
    ("xla_cpu_enable_concurrency_optimized_scheduler", "false"),  # it keeps more in memory
    ("xla_cpu_copy_insertion_use_region_analysis", "true"),  # fewer copies of what loops carry
)
"""Eight numbers of double precision at once where the processor can, as many as samples are abreast: 0.86 to 0.88 of the time of
a batch, but up to 1.18 of a single run's; the last one 0.97 of a batch's (script)."""
QUICK = NO_EMITTERS + NO_UNROLLING
"""They compile in two thirds of the time to code that is as fast (measured on the shipped scenes, jax 0.10), the second
alone in seven eighths (`diffeed bench gradient`): loops here are as long as a sheet has bars, and what can be computed side by
side is found without unrolling."""
BATCHED = NO_UNROLLING
"""Takes longer to compile than `QUICK`, to batches by `jax.vmap` that run faster; `WHOLE` and `jax.lax.map` are faster still."""
FUSED: Flags = ((EXTRA, "xla_cpu_use_multi_output_fusion"),)
"""One loop makes several results: with jaxlib 0.12 batches and gradients gain by it, with 0.10 nothing that was measured. Not for
every scene: up to jaxlib 0.10 the compiler goes on with some (those of `runge_kutta` among them) until the memory is full."""
PLAIN: Flags = (("xla_backend_optimization_level", "0"),)
"""Compiles in half the time to code that takes twice as long, or three times: for programs that run a few times only."""

KNOWN: dict[str, tuple[Version, ...]] = {
    "xla_cpu_use_fusion_emitters": ((0, 8), (0, 9), (0, 10)),
    EXTRA: ((0, 8), (0, 9), (0, 10), (0, 12)),  # ends the process in 0.11
    "xla_cpu_experimental_ynn_fusion_type": ((0, 10), (0, 12)),
    "xla_cpu_prefer_vector_width": ((0, 8), (0, 9), (0, 10), (0, 12)),
    "xla_cpu_copy_insertion_use_region_analysis": ((0, 8), (0, 9), (0, 10), (0, 12)),
    "xla_cpu_enable_concurrency_optimized_scheduler": ((0, 8), (0, 9), (0, 10), (0, 12)),
    "xla_backend_optimization_level": ((0, 8), (0, 9), (0, 10), (0, 11), (0, 12)),
}
"""Versions of jaxlib that are known to take a flag: one that the compiler does not know ends the process."""
SURE: tuple[Version, ...] = ((0, 12),)
"""Versions of jaxlib with which `FUSED` compiled all that the tests compile, and as quickly."""


GARBAGE = 20_000
"""Objects that Python makes before it looks for garbage. Tracing makes many, and all of them live: looking after every 700, as
Python does unasked, finds nothing and takes a good part of its time."""


def compile_quickly() -> None:
    """Set what compiles quickly, to code that is fast for single runs (`QUICK`), except where the user has set that flag, and let
    Python look for garbage less often (`GARBAGE`): to be called before anything is compiled."""
    _set_flags(QUICK)


def compile_for_speed() -> None:
    """Set `QUICK` and `WHOLE` likewise: for thousands of steps many times over, alone, by `jax.grad`, or one after the other by
    `jax.lax.map`."""
    _set_flags(QUICK + WHOLE)


def compile_for_many() -> None:
    """Set `QUICK`, `WHOLE` and `WIDE` likewise: for runs of many samples abreast (`diffeed.abreast.for_many`)."""
    _set_flags(QUICK + WHOLE + WIDE)


def compile_for_batches() -> None:
    """Set `BATCHED` likewise (and `FUSED` too with the versions of `SURE`): for hundreds of runs side by side by `jax.vmap`,
    where `diffeed.abreast` does not serve."""
    _set_flags(BATCHED + FUSED if _jaxlib() in SURE else BATCHED)


def fuse_outputs() -> None:
    """Set `QUICK` and `FUSED` likewise."""
    _set_flags(QUICK + FUSED)


def compile_plainly() -> None:
    """Set `QUICK` and `PLAIN` likewise."""
    _set_flags(QUICK + PLAIN)


def _jaxlib() -> Version:
    major, minor = version("jaxlib").split(".")[:2]
    return int(major), int(minor)


def _set_flags(flags: Flags) -> None:
    given = os.environ.get("XLA_FLAGS", "")
    values: dict[str, list[str]] = {}
    for flag, value in flags:
        if flag not in given and _jaxlib() in KNOWN[flag]:
            values.setdefault(flag, []).append(value)
    ours = [f"--{flag}={','.join(each)}" for flag, each in values.items()]
    os.environ["XLA_FLAGS"] = " ".join([given, *ours]).strip()
    first, *others = gc.get_threshold()
    if 0 < first < GARBAGE:  # 0: the user has switched it off
        gc.set_threshold(GARBAGE, *others)


def cache_folder() -> Path:
    """Where compiled programs of this user are kept."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if os.path.isabs(base) else Path("~/.cache").expanduser()) / "diffeed" / "xla"


def keep_compilations() -> str:
    """Keep compiled programs for the next run; a sentence if that is not possible, else nothing."""
    import jax

    if jax.config.values["jax_compilation_cache_dir"]:  # chosen by the user
        return ""
    try:
        folder = cache_folder()
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, RuntimeError) as error:
        return f"compiled programs are not kept for the next run: {error}"
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    return ""


THREADS_PER_DEVICE = 8
"""Threads in the compiler's pool for each device: with fewer, programs of several devices wait for each other for ever (seen
with two devices on two cores, jaxlib 0.10)."""


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def use_one_core() -> None:
    """One thread in the compiler's pool, unless `NPROC` is set: to be called before anything is computed. For single runs and
    their gradients: their loops are too small to be shared, and where a core is slow to wake, handing them to a second one
    takes longer than doing them. Batches of hundreds are better off without."""
    os.environ.setdefault("NPROC", "1")


def use_all_cores() -> None:
    """One JAX device for each processor core that this process may use: to be called before anything is computed, and instead of
    `use_one_core`."""
    import jax

    os.environ.setdefault("NPROC", str(THREADS_PER_DEVICE * cores()))
    jax.config.update("jax_num_cpu_devices", cores())


def safe_devices(devices: list[Any]) -> list[Any]:
    """Those of the local devices that can work at the same time: one processor device alone, if the pool is too small."""
    if devices[0].platform != "cpu" or int(os.environ.get("NPROC", "0")) >= THREADS_PER_DEVICE * len(devices):
        return devices
    return devices[:1]
