"""Media cards: physical numbers, each with a source; what a card does to a sheet at a climate."""

import re
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from stand_in_nip import nip

import diffeed
from optimize.tolerance import media

CARDS = media.cards()
EACH = pytest.mark.parametrize("card", CARDS.values(), ids=lambda c: c.name)
SHEET = next(iter(nip().sheets))


def changed(before, after):
    """Paths of the numbers that differ between two scenes."""
    old, new = diffeed.numbers(before), diffeed.numbers(after)
    assert set(old) == set(new)
    return {path for path in old if float(old[path]) != float(new[path])}


def test_the_media_that_a_printer_meets_have_cards():
    asked = {"copy_paper_80", "copy_paper_64", "paper_120", "card_200", "card_300", "film_pet_100um", "film_pet_500um",
             "tissue_20gsm", "thermal_paper_58"}  # fmt: skip
    assert asked <= set(CARDS)
    assert all(name == card.name for name, card in CARDS.items())


@EACH
def test_a_card_is_physical(card):
    dry, normal, humid = card.youngs_modulus
    assert dry > normal > humid > 0.25 * normal
    assert card.density * 1e9 == pytest.approx(1e-3 * card.grammage / (1e-3 * card.caliper))  # kg/m2 over m: kg/m3
    assert 300.0 < card.density * 1e9 < 2000.0
    assert card.friction_factor[1] == 1.0
    assert all(0.5 < f < 2.0 for f in card.friction_factor)
    assert all(abs(c) < 0.02 for c in card.curl)  # 1/mm: not rolled tighter than a radius of 50 mm
    assert all(0.0 <= d < 0.1 for d in card.structural_damping)


@EACH
def test_every_number_has_a_source(card):
    assert set(card.sources) == set(media.UNITS)
    for quantity, source in card.sources.items():
        key = re.split(r"\W", source)[0]
        assert key in media.citations() or re.fullmatch(r"assumption: \S.{10,}", source), (quantity, source)


def test_climates_have_sources_and_every_citation_is_named():
    given = tomllib.loads(Path(media.__file__).with_name("media.toml").read_text("utf-8"))
    assert list(given["climates"]) == list(media.CLIMATES)
    named = [c["source"] for c in given["climates"].values()] + [s for c in CARDS.values() for s in c.sources.values()]
    assert all(re.split(r"\W", c["source"])[0] in media.citations() for c in given["climates"].values())
    assert {w for text in named for w in re.findall(r"\w+", text)} >= set(media.citations())


@pytest.mark.parametrize("lost", ["value", "humid", "source"])
def test_a_card_that_lacks_something_says_what(lost):
    quantity = "caliper" if lost == "value" else "curl"
    given = {q: {"value": 1.0} if q in media.FIXED else dict.fromkeys(media.CLIMATES, 1.0) for q in media.UNITS}
    given = {q: {**entry, "source": "assumption: a test"} for q, entry in given.items()}
    assert media._card("mine", {"title": "", **given}).curl == (1.0, 1.0, 1.0)
    del given[quantity][lost]
    with pytest.raises(media.MediaError, match=f"cards.mine.{quantity} must give {lost}$"):
        media._card("mine", {"title": "", **given})


@pytest.mark.parametrize(
    ("name", "medium", "climate"),
    [("copy_paper_80", "copy_paper_80", "normal"), ("card_300/humid", "card_300", "humid"),
     ("tissue_20gsm/dry", "tissue_20gsm", "dry")],
)  # fmt: skip
def test_a_medium_is_found_by_card_and_climate(name, medium, climate):
    assert media.find(name) == (CARDS[medium], climate)


@pytest.mark.parametrize(
    ("name", "said"),
    [("copy_paper_81", 'there is no card "copy_paper_81"; did you mean "copy_paper_80"?'),
     ("copper/dry", 'medium "copper/dry": there is no card "copper"'),
     ("card_200/humit", 'medium "card_200/humit": there is no climate "humit"; did you mean "humid"?'),
     ("card_200/", 'there is no climate ""; known: "dry", "humid", "normal"'),
     ("", 'there is no card ""; known: "card_200"')],
)  # fmt: skip
def test_an_unknown_name_is_refused_with_what_there_is(name, said):
    with pytest.raises(media.MediaError, match=re.escape(said)):
        media.find(name)


@EACH
@pytest.mark.parametrize("climate", media.CLIMATES)
def test_apply_gives_the_numbers_of_the_card(card, climate):
    sheet = media.apply(nip(), SHEET, card, media.CLIMATES[climate]).sheets[SHEET]
    k = ["dry", "normal", "humid"].index(climate)
    for quantity in ("youngs_modulus", "friction_factor", "curl", "structural_damping"):
        assert float(getattr(sheet, quantity)) == pytest.approx(getattr(card, quantity)[k], rel=1e-12, abs=1e-15)
    assert float(sheet.thickness) == card.caliper
    assert float(sheet.density * sheet.thickness) == pytest.approx(card.grammage * 1e-3 / 1e6)  # kg/mm2


@pytest.mark.parametrize(("climate", "share"), [(-0.25, (0.25, 0.75, 0.0)), (0.6, (0.0, 0.4, 0.6)), (-3.0, (1.0, 0.0, 0.0)),
                                                (1.5, (0.0, 0.0, 1.0))])  # fmt: skip
def test_between_climates_a_card_is_linear_and_beyond_it_stays(climate, share):
    card = CARDS["copy_paper_80"]
    sheet = media.apply(nip(), SHEET, card, climate).sheets[SHEET]
    for quantity in ("youngs_modulus", "friction_factor", "curl", "structural_damping"):
        assert float(getattr(sheet, quantity)) == pytest.approx(np.dot(share, getattr(card, quantity)), rel=1e-12)


@pytest.mark.parametrize("sample", [-0.5, 0.5, 2.0])
def test_the_gradient_in_the_climate_is_the_slope(sample):
    card = CARDS["copy_paper_80"]
    dry, normal, humid = card.youngs_modulus

    def modulus(climate):
        return media.move_climate(nip(), SHEET, card, climate).sheets[SHEET].youngs_modulus

    slope = {-0.5: normal - dry, 0.5: humid - normal, 2.0: 0.0}[sample]
    assert float(jax.grad(modulus)(sample)) == pytest.approx(slope)
    assert float(jax.grad(modulus)(jnp.float32(sample))) == pytest.approx(slope)
    assert float(jax.jit(modulus)(sample)) == pytest.approx(float(modulus(sample)))


def test_a_climate_moves_stiffness_friction_and_curl_alone():
    card = CARDS["copy_paper_80"]
    worn = diffeed.put(nip(), f"sheets.{SHEET}.thickness", 0.111)
    moved = {f"sheets.{SHEET}.{q}" for q in ("youngs_modulus", "friction_factor", "curl")}
    assert changed(worn, media.move_climate(worn, SHEET, card, 1.0)) == moved
    first, last = (media.apply(nip(), SHEET, card, c) for c in (-1.0, 1.0))
    assert changed(first, last) == moved | {f"sheets.{SHEET}.structural_damping"}


def test_a_sheet_that_is_not_there_is_named():
    with pytest.raises(ValueError, match="papper"):
        media.apply(nip(), "papper", CARDS["paper_120"], 0.0)


@EACH
def test_a_scene_with_a_card_passes_the_check(card):
    assert diffeed.check(media.apply(nip(), SHEET, card, 1.0)) == []


def test_the_table_names_every_card_number_and_source(monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    text = media.table()
    for card in CARDS.values():
        assert f"{card.name}: {card.title}" in text
        assert all(source in text for source in card.sources.values())
        assert all(f"{value:g}" in text for value in (card.grammage, card.caliper, *card.youngs_modulus, *card.curl))
    assert all(f"{key}: {cited}" in text for key, cited in media.citations().items())
    assert "normal: 23 C, 50 % r.h." in text
