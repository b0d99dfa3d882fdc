"""Media cards: what a sheet is made of and how the climate moves it. The numbers and their sources are in `media.toml`.

A climate is a number: -1 dry, 0 normal, +1 humid. Between them a card is piecewise linear; beyond them it stays.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from typing import Any

import jax.numpy as jnp

import diffeed
from diffeed.base.names import hint
from diffeed.base.terminal import console, plain_table

CLIMATES = {"dry": -1.0, "normal": 0.0, "humid": 1.0}
"""Name and number of the climates that a card gives."""
UNITS = {
    "grammage": "g/m2", "caliper": "mm", "youngs_modulus": "N/mm2", "friction_factor": "1", "curl": "1/mm",
    "structural_damping": "s",
}  # fmt: skip
"""Quantities of a card."""
FIXED = ("grammage", "caliper")
"""Quantities of which a card gives one number; of the others it gives one for each climate."""
MOVING = ("youngs_modulus", "friction_factor", "curl")
"""Quantities that move with the climate of one sheet."""
PER_G_M2 = 1e-9
"""kg/mm2 in 1 g/m2."""

Triple = tuple[float, float, float]


class MediaError(ValueError):
    """A medium or a climate that there is not."""


@dataclass(frozen=True)
class Card:
    """One medium. Three numbers are dry, normal, humid; `sources` says of each quantity where it is from."""

    name: str
    title: str
    grammage: float
    """g/m2"""
    caliper: float
    """mm"""
    youngs_modulus: Triple
    """N/mm2, in bending, machine direction"""
    friction_factor: Triple
    """times the friction of every part"""
    curl: Triple
    """1/mm at rest"""
    structural_damping: Triple
    """s"""
    sources: Mapping[str, str] = field(compare=False, repr=False)

    @property
    def density(self) -> float:
        """kg/mm3"""
        return self.grammage * PER_G_M2 / self.caliper

    def at(self, quantity: str, climate: Any) -> Any:
        """A quantity that has three numbers, at a climate. Its slope is that of the straight piece: at 0 the humid one's."""
        kind = jnp.result_type(float)
        places, values = (jnp.asarray(v, kind) for v in (tuple(CLIMATES.values()), getattr(self, quantity)))
        return jnp.interp(jnp.asarray(climate, kind), places, values)


def cards() -> dict[str, Card]:
    """Name and card of the media that come with the package."""
    return {card.name: card for card in _cards()}


def citations() -> dict[str, str]:
    """Key and text of the published sources that the cards name."""
    return dict(_file()["sources"])


def find(name: str) -> tuple[Card, str]:
    """Card and climate of "copy_paper_80/humid"; of "copy_paper_80" the climate is "normal"."""
    medium, slash, climate = name.partition("/")
    known = cards()
    if medium not in known:
        raise MediaError(f'medium "{name}": there is no card "{medium}"{hint(medium, known)}')
    climate = climate if slash else "normal"
    if climate not in CLIMATES:
        raise MediaError(f'medium "{name}": there is no climate "{climate}"{hint(climate, CLIMATES)}')
    return known[medium], climate


def apply(scene: diffeed.Scene, sheet: str, card: Card, climate: Any) -> diffeed.Scene:
    """The scene with a sheet of this medium, at a climate that may be traced. Size and place of the sheet stay."""
    scene = diffeed.put(scene, f"sheets.{sheet}.thickness", card.caliper)
    scene = diffeed.put(scene, f"sheets.{sheet}.density", card.density)
    scene = diffeed.put(scene, f"sheets.{sheet}.structural_damping", card.at("structural_damping", climate))
    return move_climate(scene, sheet, card, climate)


def move_climate(scene: diffeed.Scene, sheet: str, card: Card, climate: Any) -> diffeed.Scene:
    """The scene with a sheet in another climate: stiffness, friction and curl. Thickness and density are the sheet's own."""
    for quantity in MOVING:
        scene = diffeed.put(scene, f"sheets.{sheet}.{quantity}", card.at(quantity, climate))
    return scene


def table() -> str:
    """The cards with the source of each number, the climates and the published sources, as plain text."""
    screen = console()
    with screen.capture() as caught:
        for card in cards().values():
            screen.print(f"{card.name}: {card.title}, {card.density * 1e9:.0f} kg/m3", style="bold")
            screen.print(_rows(card), "")
        screen.print("Climates", style="bold")
        for name, given in _file()["climates"].items():
            screen.print(f"{name}: {given['air']} ({given['source']})")
        screen.print("\nPublished sources", style="bold")
        for key, text in citations().items():
            screen.print(f"{key}: {text}")
    return caught.get()


def _rows(card: Card) -> Any:
    made = plain_table("quantity", "unit", *CLIMATES, words=("unit",))
    made.add_column("source", overflow="fold")
    for column in made.columns:
        column.vertical = "top"  # sources run over several lines; a number stands beside the first
    for quantity, unit in UNITS.items():
        value = getattr(card, quantity)
        shown = [f"{v:g}" for v in value] if isinstance(value, tuple) else ["", f"{value:g}", ""]
        made.add_row(quantity, unit, *shown, card.sources[quantity])
    return made


@cache
def _file() -> dict[str, Any]:
    text = (resources.files("optimize") / "tolerance" / "media.toml").read_text("utf-8")
    return tomllib.loads(text)


@cache
def _cards() -> tuple[Card, ...]:
    return tuple(_card(name, given) for name, given in _file()["cards"].items())


def _card(name: str, given: dict[str, Any]) -> Card:
    numbers: dict[str, Any] = {}
    for quantity in UNITS:
        found, wanted = given.get(quantity, {}), ("value",) if quantity in FIXED else tuple(CLIMATES)
        missing = [key for key in (*wanted, "source") if key not in found]
        if missing:
            raise MediaError(f"media.toml: cards.{name}.{quantity} must give {', '.join(missing)}")
        numbers[quantity] = found["value"] if quantity in FIXED else tuple(found[c] for c in wanted)
    return Card(name, given["title"], **numbers, sources={q: given[q]["source"] for q in UNITS})
