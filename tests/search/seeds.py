"""What mutations start from: every scene and study file of the repository, and a scene with every kind of part."""

from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
SCENES = sorted((ROOT / "diffeed/scenes").glob("*.toml")) + sorted((ROOT / "optimize/studies/scenes").glob("*.toml"))
STUDIES = sorted((ROOT / "optimize/studies").glob("*.toml"))
ALL_KINDS = """
goal = "exit"
initial = "given"
duration = 0.1
gravity = [0.0, -9810.0]

[sheets.film]
length = 200.0
thickness = 0.5
width = 35.0
density = 2.2e-6
youngs_modulus = 2250.0
bars = 3
headings = [0.0, 1.0, 2.0]
rates = [0.0, 0.0, 0.0]
velocity = [1.0, 0.0]

[rollers.drive]
kind = "fixed"
center = [0.0, -10.0]
radius = 10.0
angular_speed = { times = [0.0, 0.1], values = [0.0, -30.0] }
contact = "rubber"
motion = { times = [0.0, 1.0], displacement = [[0.0, 0.0], [1.0, 2.0]], rotation = [0.0, 5.0], pivot = [1.0, 1.0] }

[rollers.pinch]
kind = "movable"
center = [0.0, 10.0]
direction = [0.0, 1.0]
radius = 10.0
mass = 0.02
travel_min = -1.0
travel_max = 1.0

[guides.line]
kind = "line"
start = [0.0, 0.0]
end = [10.0, 0.0]

[guides.arc]
kind = "arc"
center = [0.0, 0.0]
radius = 80.0
start_angle = -90.0
sweep = 60.0
side = "outside"

[guides.circle]
kind = "circle"
center = [5.0, 5.0]
radius = 2.0

[contacts.rubber]
stiffness = 50.0
friction_law = "tanh"
damped = false

[clamps.hold]
sheet = "film"
at = "lead"
kind = "wall"

[loads.tip]
sheet = "film"
at = "lead"
force = [0.0, -0.1]

[sensors.exit]
position = [100.0, 0.0]
direction = [1.0, 0.0]
"""


def scenes() -> list[str]:
    """Texts of scene files."""
    return [ALL_KINDS, *(file.read_text("utf-8") for file in SCENES)]


def studies() -> list[str]:
    """Texts of study files; their scenes are named by their whole paths, so that they are found from anywhere."""
    beside = {f'scene = "scenes/{file.name}"': f'scene = "{file}"' for file in SCENES}
    texts = [file.read_text("utf-8") for file in STUDIES]
    for old, new in beside.items():
        texts = [text.replace(old, new) for text in texts]
    return texts
