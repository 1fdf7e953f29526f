"""The page in a real browser, beside the command that serves it."""

import json
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tests.host.page.window import IN_A_BROWSER, drag, place_of, wait_for_text, wait_until

from mdms_array.simulation import run_scenario
from mdms_model.run.folder import BUS_LOG, write_run
from mdms_model.scenario.file import load_scenario

MDMS = Path(sys.executable).with_name("mdms")
LINE = str(Path(__file__).parents[3] / "examples" / "line" / "table.toml")

pytestmark = IN_A_BROWSER


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
        _, errors = process.communicate(timeout=120)
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
    stranger.goto(demo)
    wait_until(stranger, "!document.querySelector('#take').hidden")
    second.click("#take")
    wait_for_text(second, "#who", "in control")
    wait_for_text(first, "#who", "watching")


def test_a_table_that_is_gone_does_not_look_alive(demo, open_page):
    page = open_page(demo)
    wait_until(page, "page.snapshot !== null")
    page.evaluate("(page.wire.open = () => {}, page.wire.socket.close())")
    wait_for_text(page, "#who", "not connected")
    page.wait_for_timeout(500)
    assert page.inner_text("#phase") == "the table is gone"
    assert page.evaluate("getComputedStyle(document.querySelector('main')).opacity") == "0.5"
    page.evaluate("(delete page.wire.open, page.wire.open())")
    wait_until(page, "document.querySelector('#phase').className !== 'chip gone'")
    assert page.evaluate("getComputedStyle(document.querySelector('main')).opacity") == "1"


def test_recording_is_scrubbed(recorded, open_page):
    page = open_page(recorded)
    # How sure beliefs were is not recorded.
    assert "goal" in page.inner_text("#legend")
    assert "95 %" not in page.inner_text("#legend")
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


def test_plots_are_as_wide_as_there_is_room_beside_the_scroll_bar(demo, open_page):
    page = open_page(demo)
    page.set_viewport_size({"width": 1400, "height": 900})
    page.click("#tab-plots")
    wait_until(page, "document.querySelectorAll('#plots canvas').length >= 5")
    sizes = "((one) => [one.clientHeight, one.scrollHeight, one.clientWidth, one.scrollWidth])"
    height, whole_height, width, whole_width = page.evaluate(
        f"{sizes}(document.querySelector('#plots'))"
    )
    assert whole_height > height
    assert whole_width == width


def test_without_a_choice_the_plots_are_of_a_parcel_that_is_there(serve, open_page):
    names = {kind: [f"{kind} {k}" for k in (1, 2, 3)] for kind in ("small", "medium", "large")}
    comes = [*names["medium"], *names["large"], "disc 1", "disc 2", "disc 3"]
    away = f"{{parcels={names['small']}, x_m=-0.35, start_s=1e5}}"
    streams = f"stream=[{away}, {{parcels={comes}, x_m=-0.35}}]"
    page = open_page(serve("serve", "sort54", "--name", "page-plots", "--set", streams))
    page.click("#start")
    page.click("#tab-plots")
    there = (
        "() => { const believed = page.snapshot.parcel_believed, names = page.table.parcels.map("
        "(one) => one.name).filter((_, p) => Number.isFinite(believed[3 * p])); const heads = "
        "[...document.querySelectorAll('#plots h2')].map((one) => one.textContent); return "
        "names.some((name) => heads.some((head) => head.endsWith(`less truth, ${name} [mm]`))); }"
    )
    wait_until(page, there)


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


def test_a_name_of_one_long_word_has_its_end_in_the_picture_and_a_choice_that_fits(
    serve, open_page
):
    long = "PARCEL-0123456789-0123456789-0123456789-0123456789-0000012345678"
    page = open_page(
        serve("serve", "array18", "--name", "page-long", "--set", f"parcel.0.name={long}")
    )
    page.evaluate(
        "(window.drawn = new Set(), ((one) => { const fill = one.fillText; one.fillText = function "
        "(text, ...at) { drawn.add(text); fill.call(this, text, ...at); }; })"
        "(CanvasRenderingContext2D.prototype))"
    )
    page.click("#start")
    wait_until(page, "[...drawn].some((text) => /^…[-0-9]*12345678/.test(text))")
    page.select_option("#chosen", label=f"parcel {long}")
    fits = "document.querySelector('#chosen').getBoundingClientRect().right <= innerWidth"
    assert page.evaluate(fits)


def test_files_of_the_page_are_small():
    static = Path(__file__).parents[3] / "host/mdms_host/page/static"
    assert sum(path.stat().st_size for path in static.iterdir()) <= 165_000
    assert json.dumps([path.name for path in static.iterdir()]).count("license") == 1


def test_a_table_in_a_line_shows_its_state_and_counters(serve, open_page, tmp_path):
    options = ["--name", "page-line", "--modbus", "0", "--state", str(tmp_path)]
    page = open_page(serve("serve", LINE, *options))
    wait_for_text(page, "#machine", "Stopped")
    page.click("#tab-line")
    wait_for_text(page, "#line", "parcels an hour")
    wait_for_text(page, "#line", "No orders")
    page.click("#start")
    wait_for_text(page, "#machine", "Idle")
    wait_for_text(page, "#line", "started by hand")
    alarm = {"text": "held", "cause": "cell 3 is gone", "cure": "mend it"}
    held = {"state": "Held", "mode": "", "reason": "", "alarm": alarm, "counters": [], "orders": []}
    advice = page.evaluate(
        "(held) => (page.line.take(held), document.querySelector('#line .advice').innerText)", held
    )
    assert advice == "cell 3 is gone · mend it"
    told_once = {**held, "reason": "no heartbeat", "alarm": dict.fromkeys(alarm, "no heartbeat")}
    told_once["alarm"]["cure"] = "mend it"
    shown = page.evaluate(
        "(held) => (page.line.take(held), document.querySelector('#line').innerText)", told_once
    )
    assert shown.count("no heartbeat") == 1
    assert "mend it" in shown
