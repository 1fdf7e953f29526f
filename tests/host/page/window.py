"""A window of a real browser, and the actions and waits of tests in it."""

import shutil
import time
from pathlib import Path

import pytest

CHROMIUM = shutil.which("chromium") or "/usr/bin/chromium"
#: No sandbox where root runs the tests, no graphics, and nothing of its own to the network.
FLAGS = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)
WITHIN_S = 60.0
#: Marks of tests in a browser.
IN_A_BROWSER = [
    pytest.mark.real_time,
    pytest.mark.skipif(
        not Path(CHROMIUM).exists(),
        reason="no browser: install chromium (as .ci/run does) to have the page tested",
    ),
]


def wait_until(page, expression: str, argument: object = None) -> None:
    """Until an expression holds; asked from outside, since the page's own rules forbid `eval`."""
    end_s = time.monotonic() + WITHIN_S
    while not page.evaluate(expression, argument):
        assert time.monotonic() < end_s, (expression, page.inner_text("body"))
        page.wait_for_timeout(20)


def wait_for_text(page, selector: str, text: str) -> None:
    wait_until(
        page,
        "([selector, text]) => document.querySelector(selector).textContent.includes(text)",
        [selector, text],
    )


def place_of(page, x_m: float, y_m: float) -> tuple[float, float]:
    """Where a point of the table is in the window."""
    box = page.locator("#table").bounding_box()
    x, y = page.evaluate("([x, y]) => [page.view.px(x), page.view.py(y)]", [x_m, y_m])
    return box["x"] + x, box["y"] + y


def drag(page, start: tuple[float, float], end: tuple[float, float]) -> None:
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(*end, steps=8)
    page.mouse.up()
