"""Peak memory of a run of some length in a process of its own: `python -m diffeed.bench.memory SECONDS`."""

import json
import subprocess
import sys

DT, FRAMES = 5e-4, 11


def peak_of_a_run(seconds: float) -> dict[str, float]:
    """Peak memory (MB) of a process that imports, compiles and runs so many seconds of the transport path, and its time."""
    done = subprocess.run([sys.executable, "-m", __name__, repr(seconds)], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr.strip().splitlines()[-1] if done.stderr.strip() else "the process ended")
    return json.loads(done.stdout.splitlines()[-1])


def _main(seconds: float) -> None:
    import resource

    import jax

    from diffeed.bench.timing import timed
    from diffeed.bench.transport import transport
    from diffeed.rollout import simulate
    from diffeed.session import set_up

    set_up(keep=False)
    scene = transport(driven=26, guides=12, duration=seconds)
    made = timed(lambda s: simulate(s, dt=DT, frames=FRAMES), scene, fewest=1)
    unit = 1.0 if sys.platform == "darwin" else 1024.0  # bytes there, kilobytes elsewhere
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
    steps = seconds / float(jax.device_get(made.value.dt))
    print(json.dumps({"peak_mb": peak, "compile_seconds": made.compile, "us_per_step": 1e6 * made.run / steps}))


if __name__ == "__main__":
    _main(float(sys.argv[1]))
