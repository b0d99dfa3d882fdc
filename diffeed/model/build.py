"""`build`: a scene becomes a model. Pure jax.numpy, so that gradients pass through it."""

from diffeed.input.parts import ArcGuide, CircleGuide, LineGuide, Scene
from diffeed.model.arrays import Model
from diffeed.model.guides import circles_of, guides_of
from diffeed.model.layout import Layout
from diffeed.model.movements import movements_of
from diffeed.model.rollers import rollers_of
from diffeed.model.rows import named
from diffeed.model.sheets import bars_of, hold_of, joint_stiffness, per_bar, push_of
from diffeed.model.surfaces import any_sticks, pair_surface, surface_of


def build(scene: Scene) -> Model:
    """Model of a normalised scene; inside a trace or outside."""
    names = sorted(scene.sheets)
    sheets = [scene.sheets[name] for name in names]
    layout = Layout(tuple(names), tuple(sheet.bars for sheet in sheets))
    rollers, roller_parts = rollers_of(scene)
    lines, arcs = named(scene.guides, LineGuide), named(scene.guides, ArcGuide)
    circle_guides = named(scene.guides, CircleGuide)
    movements = movements_of(roller_parts + circle_guides, lines + arcs)
    guides = guides_of(lines, arcs, movements)
    circles, circle_owners = circles_of(rollers, roller_parts, circle_guides, guides, lines + arcs)
    pairs = tuple((i, j) for i in range(rollers.n_movable) for j in range(i + 1, rollers.n))
    return Model(
        bars=bars_of(sheets, layout),
        rollers=rollers,
        circles=circles,
        guides=guides,
        surface=surface_of(scene, circle_owners + lines + arcs),
        pair_surface=pair_surface(scene, roller_parts, pairs),
        movements=movements,
        holds=tuple(hold_of(scene, layout, scene.clamps[name]) for name in sorted(scene.clamps)),
        pushes=tuple(push_of(scene, layout, name) for name in sorted(scene.loads)),
        gravity=scene.gravity,
        wall_stiffness=per_bar(sheets, layout, joint_stiffness),
        wall_damping=per_bar(sheets, layout, lambda s: s.structural_damping * joint_stiffness(s)),
        layout=layout,
        pairs=pairs,
        n_circle_guides=len(circle_guides),
        circle_names=tuple(name for name, _ in circle_owners),
        sticks=(any_sticks(scene, circle_owners), any_sticks(scene, lines + arcs)),
        skin=scene.skin,
        crowded=scene.crowded,
    )
