"""A strip drawn by one nip: a scene that compiles and runs in seconds, for tests of what stands on the simulator."""

import diffeed


def nip(
    preload: float = 3.0, radius: float = 5.0, speed: float = -40.0, bars: int = 4, initial: str = "given"
) -> diffeed.Scene:
    return diffeed.scene(
        sheets={
            "strip": diffeed.Sheet(
                length=20.0, thickness=0.2, width=20.0, density=1e-6, youngs_modulus=2000.0, structural_damping=1e-3,
                bars=bars, lead=(12.0, 0.0),
            )
        },
        rollers={
            "drive": diffeed.FixedRoller(
                center=(0.0, -radius - 0.1), radius=radius, friction=0.8,
                angular_speed=diffeed.Profile(times=(0.0, 0.02), values=(0.0, speed)),
            ),
            "pinch": diffeed.MovableRoller(
                center=(0.0, radius + 0.1), direction=(0.0, 1.0), radius=radius, mass=0.01, spring=0.5, preload=preload,
                damper=0.01, friction=0.8,
            ),
        },
        guides={"table": diffeed.LineGuide(start=(-40.0, -0.6), end=(-3.0, -0.6))},
        sensors={"gate": diffeed.Sensor(position=(13.0, 0.0), direction=(1.0, 0.0))},
        gravity=(0.0, 0.0),
        duration=0.03,
        initial=initial,
    )  # fmt: skip
