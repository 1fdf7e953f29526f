"""Texts, controls and marks of the table stand out as WCAG 2.2 AA asks for, in both themes."""

import re
from importlib.resources import files

import pytest

SHEET = (files("mdms_host.page") / "static" / "style.css").read_text()
THEMES = {
    "light": r":root \{(.*?)\}",
    "dark": r':root\[data-theme="dark"\] \{(.*?)\}',
}
#: Success criteria 1.4.3 (texts) and 1.4.11 (controls and pictures).
TEXT, PICTURE = 4.5, 3.0
CELLS = ("cell", "running", "fault", "suspected", "silent")
TEXTS = (
    *((front, back) for front in ("text", "faint") for back in ("back", "panel")),
    *(("text", state) for state in ("running", "fault", "suspected")),
    ("on-accent", "accent"),
    ("on-stop", "stop"),
    ("on-stop", "badge"),
    ("danger", "panel"),
    ("accent", "panel"),
    ("warn", "panel"),
    ("warn", "warn-back"),
    *(("label", state) for state in CELLS),
    ("fault-text", "fault"),
    ("suspected-text", "suspected"),
)
PICTURES = (
    *((line, "back") for line in ("cell-line", "running-line", "fault-line", "suspected-line")),
    *((sign, cell) for sign in ("parcel", "true", "goal", "wheel", "slip") for cell in CELLS),
    *(("covered", cell) for cell in ("cell", "running")),
    *(("sensor", cell) for cell in ("cell", "running")),
    ("spread", "running"),
    ("edge", "panel"),
    ("accent", "panel"),
    ("stop", "panel"),
)


def colours_of(theme: str) -> dict[str, tuple[int, ...]]:
    """The colours of a theme by name, 0 to 255 by channel."""
    (block,) = re.findall(THEMES[theme], SHEET, re.DOTALL)
    found = re.findall(r"--([\w-]+): (#[0-9a-f]{6});", block)
    return {name: tuple(bytes.fromhex(code[1:])) for name, code in found}


def luminance(colour: tuple[int, ...]) -> float:
    """Relative luminance, as WCAG defines it."""
    shares = [channel / 255 for channel in colour]
    linear = [s / 12.92 if s <= 0.04045 else ((s + 0.055) / 1.055) ** 2.4 for s in shares]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: tuple[int, ...], other: tuple[int, ...]) -> float:
    """From 1 to 21."""
    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


def test_contrast_is_that_of_wcag():
    assert contrast((255, 255, 255), (0, 0, 0)) == pytest.approx(21.0)
    assert contrast((118, 118, 118), (255, 255, 255)) == pytest.approx(4.54, abs=0.01)


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize(("pairs", "least"), [(TEXTS, TEXT), (PICTURES, PICTURE)])
def test_everything_stands_out(theme, pairs, least):
    colours = colours_of(theme)
    found = {(front, back): contrast(colours[front], colours[back]) for front, back in pairs}
    assert {pair: round(ratio, 2) for pair, ratio in found.items() if ratio < least} == {}


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize(
    ("module", "array", "back"),
    [("plots.js", "LINES", "panel"), ("table.js", "IDENTITIES", "running")],
)
def test_lines_that_are_the_same_in_both_themes_stand_out_in_both(theme, module, array, back):
    source = (files("mdms_host.page") / "static" / module).read_text()
    (listed,) = re.findall(rf"const {array} = \[(.*?)\]", source)
    lines = re.findall(r"#[0-9a-f]{6}", listed)
    assert len(lines) >= 8
    ground = colours_of(theme)[back]
    found = {line: contrast(tuple(bytes.fromhex(line[1:])), ground) for line in lines}
    assert {line: round(ratio, 2) for line, ratio in found.items() if ratio < PICTURE} == {}


def test_both_themes_have_the_same_colours():
    assert colours_of("light").keys() == colours_of("dark").keys()
