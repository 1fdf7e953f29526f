"""The page in a real browser, beside the command that serves it."""

import json
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import expect, sync_playwright
from tests.host.page.bench import OpenPage, StillTable

from mdms_host.cli.simulation.compose import run_scenario
from mdms_host.page import commands
from mdms_host.page.commands import Command
from mdms_model.run.folder import BUS_LOG, write_run
from mdms_model.scenario.fault import Fault
from mdms_model.scenario.file import load_scenario

CHROMIUM = shutil.which("chromium") or "/usr/bin/chromium"
#: No sandbox where root runs the tests, no graphics, and nothing of its own to the network.
FLAGS = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)
WITHIN_S = 20.0
MDMS = Path(sys.executable).with_name("mdms")

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.skipif(
        not Path(CHROMIUM).exists(),
        reason="no browser: install chromium (as .ci/run does) to have the page tested",
    ),
]


@pytest.fixture(scope="module")
def browser() -> Iterator[object]:
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=[*FLAGS])
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def serve() -> Iterator[Callable[..., str]]:
    """Starts `mdms` with a page; returns its address."""
    processes = []

    def start(*arguments: str) -> str:
        command = [str(MDMS), *arguments, "--page", "0"]
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        processes.append(process)
        address = process.stdout.readline().strip()
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/#token=[\w-]+", address), (
            address or process.stderr.read()
        )
        return address

    yield start
    for process in processes:
        process.send_signal(signal.SIGINT)
    for process in processes:
        _, errors = process.communicate(timeout=20)
        assert process.returncode == 0, errors


@pytest.fixture(scope="module")
def demo(serve) -> str:
    return serve("demo")


@pytest.fixture(scope="module")
def recorded(serve, tmp_path_factory) -> str:
    folder = tmp_path_factory.mktemp("run")
    scenario = load_scenario("array18", ["run.duration_s=4"])
    record = run_scenario(scenario, bus_log=folder / BUS_LOG).record
    write_run(folder, scenario, record, {})
    return serve("replay", str(folder))


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


def until_running(page) -> None:
    if "no program" in page.inner_text("#phase") or "stopped" in page.inner_text("#phase"):
        page.click("#start")
    wait_for_text(page, "#phase", "running")


def test_goal_is_dragged_and_the_parcel_arrives(demo, open_page):
    page = open_page(demo)
    until_running(page)
    page.select_option("#speed", "2")
    wait_until(page, "page.snapshot.parcel_state[0] === 3")
    believed = page.evaluate("[...page.snapshot.parcel_believed]")
    # Taken beside its goal's cross, the parcel itself is dragged: its goal goes with it.
    start = place_of(page, believed[0] + 0.06, believed[1] - 0.05)
    end = place_of(page, believed[0] - 0.04, believed[1] - 0.02)
    drag(page, start, end)
    wait_until(page, "page.snapshot.parcel_state[0] === 1")
    wanted = [believed[0] - 0.1, believed[1] + 0.03]
    wait_until(
        page,
        "([x, y]) => Math.hypot(page.snapshot.parcel_goal[0] - x, page.snapshot.parcel_goal[1] - y)"
        " < 0.005",
        wanted,
    )
    wait_until(page, "page.snapshot.parcel_state[0] === 3")
    true = page.evaluate("[...page.snapshot.parcel_true]")
    assert true[:2] == pytest.approx(wanted, abs=0.012)


def test_stop_all_by_button_and_by_space_bar(demo, open_page):
    page = open_page(demo)
    for stop in (lambda: page.click("#stop-all"), lambda: page.keyboard.press("Space")):
        until_running(page)
        stop()
        wait_for_text(page, "#phase", "stopped")
        assert not page.evaluate("page.snapshot.cell_state.includes(3)")
    page.click("#tab-events")
    page.fill("#filter", "stop")
    lines = page.locator("#event-list li").all_inner_texts()
    assert lines
    assert all("stop" in line.lower() for line in lines)
    # A space that is written stops nothing.
    page.click("#start")
    wait_for_text(page, "#phase", "running")
    page.click("#filter")
    page.keyboard.press("Space")
    page.wait_for_timeout(300)
    assert page.inner_text("#phase") == "running"
    # One after a speed has been chosen stops all.
    page.focus("#speed")
    page.select_option("#speed", "1")
    page.keyboard.press("Space")
    wait_for_text(page, "#phase", "stopped")


def test_killed_cell_is_shown_and_revived(demo, open_page):
    page = open_page(demo)
    page.mouse.click(*place_of(page, -0.3175, 0.127))
    wait_for_text(page, "#facts", "state")
    assert page.input_value("#chosen") == "cell 12"
    page.click("text=Kill")
    wait_for_text(page, "#facts", "silent")
    assert page.evaluate("page.snapshot.cell_state[12]") == 1
    page.click("#tab-faults")
    wait_for_text(page, "#fault-list", "cell 13: cells lose power")
    page.click("#tab-details")
    page.click("text=Revive")
    wait_until(page, "page.snapshot.cell_state[12] >= 2")
    page.click("text=Read objects")
    wait_for_text(page, "#objects", "Axis 1")


def test_second_client_watches_until_it_takes_control(demo, open_page):
    first = open_page(demo)
    wait_for_text(first, "#who", "in control")
    second = open_page(demo)
    wait_for_text(second, "#who", "watching · 1 more")
    assert second.is_disabled("#start")
    assert second.is_enabled("#stop-all")
    stranger = open_page(demo.split("#")[0])
    assert stranger.is_enabled("#stop-all")
    assert stranger.is_disabled("#start")
    assert not stranger.is_visible("#take")
    second.click("#take")
    wait_for_text(second, "#who", "in control")
    wait_for_text(first, "#who", "watching")


def test_recording_is_scrubbed(recorded, open_page):
    page = open_page(recorded)
    page.click("#pause")
    wait_until(page, "page.snapshot.paused[0] === 1")
    page.fill("#scrub", "3")
    wait_until(page, "page.snapshot.time[0] === 3")
    later = page.evaluate("[...page.snapshot.parcel_true]")
    page.fill("#scrub", "0.5")
    wait_until(page, "page.snapshot.time[0] === 0.5")
    sooner = page.evaluate("[...page.snapshot.parcel_true]")
    assert later[0] > sooner[0] + 0.1
    assert page.evaluate("page.snapshot.cell_state.every((state) => state === 3)")
    page.click("#tab-plots")
    wait_until(page, "page.history.snapshots.length > 100")
    assert page.locator("#plots canvas").count() >= 5
    assert page.locator(".plot .help").count() == 4


@pytest.fixture
def still() -> Iterator[tuple[StillTable, str]]:
    """A table that only writes down what it is asked for, and the address of its page."""
    table = StillTable()
    opened = OpenPage(table)
    yield table, opened.page.address
    opened.close()


def wait_for_commands(page, table: StillTable, count: int) -> None:
    end_s = time.monotonic() + WITHIN_S
    while len(table.done) < count:
        assert time.monotonic() < end_s, table.done
        page.wait_for_timeout(20)


def asked(page, table: StillTable) -> Command:
    """The one command that has come, or comes."""
    wait_for_commands(page, table, 1)
    (command,) = table.done
    table.done.clear()
    return command


def test_every_hand_asks_for_what_it_does(still, open_page):
    table, address = still
    page = open_page(address)
    box = place_of(page, -0.15, 0.04)
    beside = place_of(page, -0.05, 0.08)
    page.click("[data-tool=push]")
    drag(page, box, beside)
    push = asked(page, table)
    assert push.fault.kind == "push"
    assert push.fault.impulse_n_s == pytest.approx((0.5, 0.2), abs=0.02)
    page.click("[data-tool=goal]")
    page.mouse.click(*box)
    assert page.input_value("[name='x [mm]']") == "-150"
    page.fill("[name='x [mm]']", "50")
    page.fill("[name='yaw [°]']", "")
    page.click("text=Set goal")
    assert asked(page, table) == commands.Goal("box", 0.05, 0.0)
    page.click("text=Lift >> nth=1")
    assert asked(page, table) == commands.BeginFault(Fault("lift", parcel="box"))
    page.mouse.click(*place_of(page, -0.3175, 0.127))
    for text, fault in (
        ("Hang", Fault("hang", cells=(13,))),
        ("Sensors stuck free", Fault("sensor_stuck", cells=(13,), covered=False)),
        ("Cut off the bus", Fault("cut", cells=(13,))),
    ):
        page.click(f"text={text}")
        assert asked(page, table) == commands.BeginFault(fault)
    page.click("#tab-faults")
    page.fill("[name=cells]", "3, 4")
    page.click("#fault-form button")
    assert asked(page, table) == commands.BeginFault(Fault("loss", cells=(3, 4), probability=0.1))
    page.click("#pause")
    assert asked(page, table) == commands.Pause()
    page.click("#step")
    assert asked(page, table) == commands.Step()
    page.select_option("#speed", "0.25")
    assert asked(page, table) == commands.Speed(0.25)
    # A choice that has been made does not swallow the space bar.
    page.keyboard.press("Space")
    assert asked(page, table) == commands.StopAll()


def test_table_is_zoomed_and_panned_by_wheel_hand_and_keys(still, open_page):
    _, address = still
    page = open_page(address)
    before = page.evaluate("[page.view.scale, page.view.x, page.view.y]")
    page.mouse.move(*place_of(page, 0.0, 0.0))
    page.mouse.wheel(0, -300)
    wait_until(page, "before => page.view.scale > 1.3 * before[0]", before)
    # What is under the pointer stays there.
    assert page.evaluate("[page.view.x, page.view.y]") == pytest.approx(before[1:], abs=1e-3)
    drag(page, place_of(page, 0.0, 0.15), place_of(page, -0.1, 0.15))
    assert page.evaluate("page.view.x") == pytest.approx(0.1, abs=0.01)
    page.focus("#table")
    page.keyboard.press("ArrowUp")
    assert page.evaluate("page.view.y") > before[2]
    page.keyboard.press("0")
    assert page.evaluate("[page.view.scale, page.view.x, page.view.y]") == before
    assert page.get_attribute("#table", "aria-label") == "The table from above: 18 off"


#: Notes where texts of the picture are: left, top, right, bottom.
SPY = """
window.texts = [];
const fill = CanvasRenderingContext2D.prototype.fillText;
CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {
  const size = this.measureText(text), left = x - size.actualBoundingBoxLeft;
  const top = y - size.actualBoundingBoxAscent, bottom = y + size.actualBoundingBoxDescent;
  if (/\\d$/.test(text)) window.texts.push([text, left, top, left + size.width, bottom]);
  fill.call(this, text, x, y);
};
"""


@pytest.mark.parametrize(
    ("columns", "rows", "width"), [(6, 3, 390), (9, 6, 1280), (9, 6, 390), (30, 6, 1280)]
)
def test_numbers_of_cells_cover_neither_sensors_nor_each_other(browser, columns, rows, width):
    opened = OpenPage(StillTable(columns, rows))
    context = browser.new_context(viewport={"width": width, "height": 760})
    page = context.new_page()
    page.add_init_script(SPY)
    page.goto(opened.page.address)
    wait_until(page, "Boolean(window.page?.snapshot && window.page.control)")
    page.evaluate("window.texts = []; page.picture.kept = ''; page.redraw()")
    page.wait_for_timeout(200)
    size, radius, sensors, texts = page.evaluate(
        "[page.table.pitch_m * page.view.scale, page.picture.sensorRadius,"
        " page.table.cells_m.flatMap(([x, y]) => page.table.sensors_m.map(([dx, dy]) =>"
        "   [page.view.px(x + dx), page.view.py(y + dy)])), window.texts]"
    )
    context.close()
    opened.close()
    numbers = texts[: columns * rows]
    # Whoever is too far off for numbers has none.
    assert len(numbers) == (columns * rows if size > 24 else 0)
    for text, left, top, right, bottom in numbers:
        assert right - left < size, text
        if size > 34:
            near = [(x, y) for x, y in sensors if left - radius < x < right + radius]
            assert not [y for _, y in near if top - radius < y < bottom + radius], (text, size)


def test_what_is_unknown_is_named_with_the_size_that_is_proposed_or_as_a_disc(still, open_page):
    table, address = still
    page = open_page(address)
    page.mouse.click(*place_of(page, 0.2, 0.05))
    name, outline = "[aria-label='Name of the parcel']", "[aria-label='Outline of the parcel']"
    page.fill(name, "tray")
    page.click("text=Name it")
    page.select_option(outline, "disc")
    assert not page.is_visible("text=width [mm]")
    assert page.input_value("[aria-label='diameter [mm]']") == "220"
    page.click("text=Name it")
    wait_for_commands(page, table, 2)
    assert table.done == [
        commands.Name("unknown-1", "tray", 0.24, 0.2, spread_m=0.005),
        commands.Name("unknown-1", "tray", 0.22, 0.22, shape="disc"),
    ]


def test_plots_show_latest_values_and_how_lines_are_drawn(still, open_page):
    _, address = still
    page = open_page(address)
    page.click("#tab-plots")
    for title, value in (("Bus load", "47.0"), ("Error frames", "2.50")):
        shown = page.locator(".plot", has_text=title).locator(".u-value").nth(1)
        expect(shown).to_have_text(value)
    styles = page.eval_on_selector_all(
        ".u-marker", "marks => marks.map((mark) => getComputedStyle(mark).borderTopStyle)"
    )
    assert {"solid", "dashed"} <= {*styles}
    reasons = page.locator(".plot .help").all_inner_texts()
    assert any("no frame has them" in reason for reason in reasons)


def test_parcel_stays_where_it_is_when_the_page_goes_while_its_goal_is_dragged(demo, open_page):
    watcher, page = open_page(demo), open_page(demo)
    page.click("#take")
    until_running(page)
    wait_until(page, "page.snapshot.parcel_state[0] === 3")
    x_m, y_m, _ = page.evaluate("[...page.snapshot.parcel_believed]")
    page.mouse.move(*place_of(page, x_m + 0.06, y_m - 0.05))
    page.mouse.down()
    page.mouse.move(*place_of(page, x_m - 0.02, y_m - 0.05), steps=5)
    wait_until(page, "page.snapshot.parcel_state[0] === 1")
    # As long as the hand rests, it holds the goal.
    page.wait_for_timeout(1300)
    watcher.click("#tab-events")
    assert "stays where it is" not in watcher.inner_text("#event-list")
    page.context.close()
    wait_for_text(watcher, "#event-list", "box stays where it is")


@pytest.mark.parametrize("where", ["demo", "recorded"])
def test_every_control_has_a_name(where, open_page, request):
    page = open_page(request.getfixturevalue(where))
    if where == "demo":
        page.mouse.click(*place_of(page, 0.3, 0.12))
    session = page.context.new_cdp_session(page)
    for tab in ("details", "plots", "events", "faults"):
        if page.is_visible(f"#tab-{tab}"):
            page.click(f"#tab-{tab}")
            nodes = session.send("Accessibility.getFullAXTree")["nodes"]
            nameless = [node for node in nodes if is_control(node) and not name_of(node)]
            assert nameless == []


def is_control(node: dict) -> bool:
    """Whether a node of the accessibility tree is something to work with."""
    roles = (
        "button",
        "checkbox",
        "combobox",
        "slider",
        "spinbutton",
        "searchbox",
        "textbox",
        "tab",
    )
    return not node.get("ignored") and node.get("role", {}).get("value") in (*roles, "image", "img")


def name_of(node: dict) -> str:
    return node.get("name", {}).get("value", "").strip()


def test_page_fits_a_phone_and_both_themes(demo, open_page):
    page = open_page(demo, color_scheme="dark")
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"
    page.click("#theme")
    assert page.evaluate("document.documentElement.dataset.theme") == "light"
    page.set_viewport_size({"width": 390, "height": 800})
    page.wait_for_timeout(200)
    for tab in ("details", "plots", "events", "faults"):
        page.click(f"#tab-{tab}")
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert page.evaluate("document.querySelector('#side').scrollWidth <= innerWidth")
        assert page.is_visible("#stop-all")


def test_files_of_the_page_are_small():
    static = Path(__file__).parents[3] / "host/mdms_host/page/static"
    assert sum(path.stat().st_size for path in static.iterdir()) <= 150_000
    assert json.dumps([path.name for path in static.iterdir()]).count("license") == 1
