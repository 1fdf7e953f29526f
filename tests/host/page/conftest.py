from collections.abc import Callable, Iterator

import pytest
from playwright.sync_api import sync_playwright
from tests.host.page.bench import Desk
from tests.host.page.window import CHROMIUM, FLAGS, wait_until

from mdms_host.page import commands


@pytest.fixture
def desk(monkeypatch) -> Desk:
    """The prototype's table, before anybody has started anything."""
    return Desk(monkeypatch)


@pytest.fixture
def running(desk) -> Desk:
    """The same, while its program runs."""
    desk.table.do(commands.Start())
    desk.run_until(lambda: "running" in desk.texts, 3.0)
    return desk


@pytest.fixture(scope="module")
def browser() -> Iterator[object]:
    with sync_playwright() as playwright:
        # Scroll bars take their room, as in the window of a person.
        chromium = playwright.chromium.launch(
            executable_path=CHROMIUM, args=[*FLAGS], ignore_default_args=["--hide-scrollbars"]
        )
        yield chromium
        chromium.close()


@pytest.fixture
def open_page(browser) -> Iterator[Callable[..., object]]:
    """Opens an address in a window of its own, and fails for any error or foreign request."""
    contexts, wrong = [], []

    def open_one(address: str, **options: object) -> object:
        context = browser.new_context(viewport={"width": 1280, "height": 760}, **options)
        contexts.append(context)
        page = context.new_page()
        origin = address.split("/#", maxsplit=1)[0]
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on(
            "console",
            lambda message: wrong.append(message.text) if message.type == "error" else None,
        )
        page.on(
            "request",
            lambda request: (
                wrong.append(request.url) if not request.url.startswith((origin, "data:")) else None
            ),
        )
        page.on(
            "websocket",
            lambda socket: (
                wrong.append(socket.url)
                if not socket.url.startswith(origin.replace("http", "ws"))
                else None
            ),
        )
        page.goto(address)
        wait_until(page, "Boolean(window.page?.snapshot && window.page.control)")
        return page

    yield open_one
    for context in contexts:
        context.close()
    assert wrong == []
