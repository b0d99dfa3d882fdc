"""Compiler settings for a whole program, such as the command line; a library leaves them to its user."""

import os
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

QUICK = {"xla_cpu_use_fusion_emitters": "false"}
"""Compiles in two thirds of the time to code that is as fast (measured on the shipped scenes, jax 0.10)."""
FUSED = QUICK | {"xla_backend_extra_options": "xla_cpu_use_multi_output_fusion"}
"""One loop makes several results: steps take two thirds of the time, gradients half. Not for every scene: with some (those
of `runge_kutta` among them) the compiler goes on until the memory is full."""


NEWEST = (0, 10)
"""Version of jaxlib up to which these flags are known to exist: one that the compiler does not know ends the process."""


def compile_quickly() -> None:
    """Set `QUICK` for this process, except where the user has set that flag: to be called before anything is compiled."""
    _set_flags(QUICK)


def fuse_outputs() -> None:
    """Set `FUSED` likewise."""
    _set_flags(FUSED)


def _set_flags(flags: dict[str, str]) -> None:
    if tuple(int(n) for n in version("jaxlib").split(".")[:2]) > NEWEST:
        return
    given = os.environ.get("XLA_FLAGS", "")
    ours = [f"--{name}={value}" for name, value in flags.items() if name not in given]
    os.environ["XLA_FLAGS"] = " ".join([given, *ours]).strip()


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


def use_all_cores() -> None:
    """One JAX device for each processor core that this process may use: to be called before anything is computed."""
    import jax

    os.environ.setdefault("NPROC", str(THREADS_PER_DEVICE * cores()))
    jax.config.update("jax_num_cpu_devices", cores())


def safe_devices(devices: list[Any]) -> list[Any]:
    """Those of the local devices that can work at the same time: one processor device alone, if the pool is too small."""
    if devices[0].platform != "cpu" or int(os.environ.get("NPROC", "0")) >= THREADS_PER_DEVICE * len(devices):
        return devices
    return devices[:1]
