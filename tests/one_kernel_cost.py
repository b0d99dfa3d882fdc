"""What one kernel of a loop of steps gains: `python -m tests.one_kernel_cost [SCENE] [STEPS]`, in turns with programs of many
kernels, each in a process of its own, for compiler settings are those of a process."""

import functools
import json
import subprocess
import sys
import time

TURNS, SAMPLES = 7, 64
WAYS = {"one kernel": "compile_for_speed", "many kernels": "compile_for_batches"}


def main(scene: str = "film_feeder", steps: str = "800") -> None:
    started = {
        name: subprocess.Popen(
            [sys.executable, "-m", "tests.one_kernel_cost", "--worker", call, scene, steps],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for name, call in WAYS.items()
    }
    answers = {name: {} for name in WAYS}
    for turn in range(TURNS + 1):
        for name, process in started.items():
            process.stdin.write("\n")
            process.stdin.flush()
            for what, value in json.loads(process.stdout.readline()).items():
                if turn:  # the first one compiles
                    answers[name].setdefault(what, []).append(value)
                else:
                    print(f"{name}: {what} compiled in {value:.1f} s", flush=True)
    for what in answers["one kernel"]:
        one, many = (sorted(answers[name][what]) for name in WAYS)
        ratios = sorted(a / b for a, b in zip(answers["one kernel"][what], answers["many kernels"][what], strict=True))
        took = f"{one[TURNS // 2]:.1f} us a step in one kernel, {many[TURNS // 2]:.1f} in many"
        print(f"{what}: {took}; ratio {ratios[TURNS // 2]:.2f}")
    for process in started.values():
        process.stdin.close()
        process.wait()


def worker(call: str, where: str, steps: str) -> None:
    """Answers each line with what every program takes, us a step and sample; the first time with what compiling takes, s."""
    from diffeed import tuning

    getattr(tuning, call)()
    tuning.use_one_core()
    import jax

    import diffeed
    from diffeed.base.batching import for_each
    from diffeed.bench.batch import samples
    from diffeed.input.parts import normalise
    from diffeed.run.examine import prepare

    jax.config.update("jax_enable_x64", True)
    scene = normalise(diffeed.load_scene(where))
    start, n = prepare(scene).state, int(steps)
    modulus = f"sheets.{next(iter(scene.sheets))}.youngs_modulus"

    def end(scene, count):
        run = diffeed.simulate(scene, duration=count * 1e-4, dt=1e-4, frames=2, initial=start)
        return run.final.state.x.sum()

    def slope(scene):
        return jax.value_and_grad(lambda v: end(diffeed.put(scene, modulus, v), n // 4))(diffeed.get(scene, modulus))

    few = n // 2
    programs = {
        "run": (functools.partial(end, count=n), scene, n),
        f"batch of {SAMPLES}": (for_each(functools.partial(end, count=few)), samples(scene, SAMPLES), SAMPLES * few),
        "gradient": (slope, scene, n // 4),
    }
    compiled = {}
    for _ in sys.stdin:
        spent = {}
        for what, (function, given, all_steps) in programs.items():
            began = time.perf_counter()
            if what not in compiled:
                compiled[what] = jax.jit(function).lower(given).compile()
                spent[what] = time.perf_counter() - began
                jax.block_until_ready(compiled[what](given))
            else:
                jax.block_until_ready(compiled[what](given))
                spent[what] = 1e6 * (time.perf_counter() - began) / all_steps
        print(json.dumps(spent), flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        worker(*sys.argv[2:])
    else:
        main(*sys.argv[1:])
