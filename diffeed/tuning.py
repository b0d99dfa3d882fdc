"""Compiler settings for a whole program, such as the command line; a library leaves them to its user."""

import os
import tempfile
from pathlib import Path

LONG = 50_000
"""Steps from which optimised machine code repays its compilation (measured: some 8 s more, 0.09 ms less per step)."""


def compile_quickly(quickly: bool) -> None:
    """From now on compile in a third of the time to code that takes twice as long, or the other way round."""
    import jax

    jax.config.update("jax_disable_most_optimizations", quickly)


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
