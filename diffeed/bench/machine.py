"""The machine on which times were taken, in words."""

import os
import platform
import subprocess
import time
from pathlib import Path
from typing import Any


def machine() -> dict[str, Any]:
    """Processor, cores that this process may use, versions, and the device that JAX computes on."""
    import jax

    import diffeed
    from diffeed import tuning

    device = jax.devices()[0]
    return {
        "processor": _processor(),
        "cores": tuning.cores(),
        "device": f"{device.platform}: {device.device_kind}",
        "jax": jax.__version__,
        "diffeed": diffeed.__version__,
        "commit": _commit(),
        "python": platform.python_version(),
        "load": _others_at_work(),
    }


def sentence(found: dict[str, Any]) -> str:
    """One line; says so if other programs were at work."""
    busy = found.get("load")
    noise = f"; {busy:.1f} other tasks ran when it began, so times are noisy" if busy and busy > 0.5 else ""
    return (
        f"{found['processor']}, {found['cores']} cores, {found['device']}; jax {found['jax']}, "
        f"diffeed {found['diffeed']}{noise}"
    )


def _others_at_work(readings: int = 10, apart: float = 0.05) -> float | None:
    """Tasks of other programs that run now. A mean over the last minute would count the benchmark that ended just before."""
    running = []
    try:
        for _ in range(readings):
            running.append(int(Path("/proc/loadavg").read_text("ascii").split()[3].split("/")[0]))
            time.sleep(apart)
    except (OSError, ValueError, IndexError):  # other systems tell the mean at best
        return os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return max(0.0, sum(running) / readings - 1.0)  # one of them is the reader


def _commit() -> str | None:
    """Of the working copy that the package lies in; none where it is installed."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return None
    try:
        words = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12"]
        return subprocess.run(words, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None


def _processor() -> str:
    """The model's name: Linux knows it, other systems say what they can."""
    try:
        for line in Path("/proc/cpuinfo").read_text("utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine() or "processor unknown"
