"""Gestures in a browser ask the table for their commands, and its picture can be read."""

import time
from collections.abc import Iterator

import pytest
from playwright.sync_api import expect
from tests.host.page.bench import OpenPage, StillTable
from tests.host.page.window import IN_A_BROWSER, WITHIN_S, drag, place_of, wait_until

from mdms_host.page import commands
from mdms_host.page.commands import Command
from mdms_model.scenario.fault import Fault

pytestmark = IN_A_BROWSER


@pytest.fixture
def still() -> Iterator[tuple[StillTable, str]]:
    """A table that only records its commands, and the address of its page."""
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


def test_every_hand_asks_for_its_own_command(still, open_page):
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
    page.fill("#signal-form [name=name]", "scanner")
    page.fill("#signal-form [name=value]", "A 1")
    page.click("#signal-form button")
    assert asked(page, table) == commands.Signal("scanner", "A 1")
    page.click("#pause")
    assert asked(page, table) == commands.Pause()
    page.click("#step")
    assert asked(page, table) == commands.Step()
    page.select_option("#speed", "0.25")
    assert asked(page, table) == commands.Speed(0.25)
    # A choice that has been made does not swallow the space bar.
    page.keyboard.press("Space")
    assert asked(page, table) == commands.StopAll()


@pytest.mark.parametrize("by", ["Escape", "a second finger"])
def test_a_drag_that_is_broken_off_puts_a_lifted_parcel_back(still, open_page, by):
    table, address = still
    page = open_page(address)
    table.answer = "fault 7"
    page.click("[data-tool=lift]")
    page.mouse.move(*place_of(page, -0.15, 0.04))
    page.mouse.down()
    page.mouse.move(*place_of(page, 0.05, 0.08), steps=8)
    assert asked(page, table) == commands.BeginFault(Fault("lift", parcel="box"))
    if by == "Escape":
        page.keyboard.press(by)
    else:
        finger = {"pointerId": 9, "pointerType": "touch", "isPrimary": False}
        # Only a pointer of the browser's own can be captured.
        page.evaluate("page.picture.canvas.setPointerCapture = () => {}")
        page.dispatch_event("#table", "pointerdown", finger)
    assert asked(page, table) == commands.EndFault(7)
    page.mouse.up()
    page.keyboard.press("Space")
    assert asked(page, table) == commands.StopAll()


def test_a_drag_ends_where_another_parcel_takes_the_number_of_its_own(still, open_page):
    table, address = still
    page = open_page(address)
    page.mouse.move(*place_of(page, -0.15, 0.04))
    page.mouse.down()
    page.mouse.move(*place_of(page, -0.05, 0.08), steps=8)
    wait_for_commands(page, table, 1)
    table._things = {"crate": table._things["box"], "unknown-1": table._things["unknown-1"]}
    table.version = 2
    wait_until(page, "() => page.table.parcels[0].name === 'crate'")
    page.mouse.up()
    page.keyboard.press("Space")
    wait_until(page, "() => page.wire.waiting.size === 0")
    *goals, stop = table.done
    assert {goal.parcel for goal in goals} == {"box"}
    assert stop == commands.StopAll()


def test_a_drag_does_not_outlive_its_connection(still, open_page):
    table, address = still
    page = open_page(address)
    page.mouse.move(*place_of(page, -0.15, 0.04))
    page.mouse.down()
    page.mouse.move(*place_of(page, -0.05, 0.08), steps=8)
    wait_for_commands(page, table, 1)
    page.evaluate("page.wire.socket.close()")
    wait_until(page, "() => !page.mayMove")
    table.done.clear()
    wait_until(page, "() => page.mayMove")
    page.mouse.move(*place_of(page, 0.05, 0.08), steps=8)
    page.mouse.up()
    page.keyboard.press("Space")
    assert asked(page, table) == commands.StopAll()


def test_a_page_that_is_open_in_the_evening_turns_dark_and_fits_long_names(still, open_page):
    page = open_page(still[1])
    for theme in ("dark", "light"):
        page.emulate_media(color_scheme=theme)
        wait_until(page, "theme => document.documentElement.dataset.theme === theme", theme)
    page.evaluate(
        "name => page.line.take({ state: 'Held', mode: 'Production', reason: name, alarm: null,"
        " counters: [[name, '1']], orders: [[name, name, name, 'under way']] })",
        "k" * 64,
    )
    page.click("#tab-line")
    panel = page.locator("#line")
    assert panel.evaluate("panel => panel.scrollWidth <= panel.clientWidth")


def test_table_is_zoomed_and_panned_by_wheel_hand_and_keys(still, open_page):
    _, address = still
    page = open_page(address)
    before = page.evaluate("[page.view.scale, page.view.x, page.view.y]")
    page.mouse.move(*place_of(page, 0.0, 0.0))
    page.mouse.wheel(0, -300)
    wait_until(page, "before => page.view.scale > 1.3 * before[0]", before)
    # The point under the pointer stays there.
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
    # Cells that are drawn too small have no numbers.
    assert len(numbers) == (columns * rows if size > 24 else 0)
    for text, left, top, right, bottom in numbers:
        assert right - left < size, text
        if size > 34:
            near = [(x, y) for x, y in sensors if left - radius < x < right + radius]
            assert not [y for _, y in near if top - radius < y < bottom + radius], (text, size)


def test_an_unknown_thing_is_named_with_the_proposed_size_or_as_a_disc(still, open_page):
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


def test_dragging_something_unknown_offers_to_name_it(still, open_page):
    table, address = still
    page = open_page(address)
    page.click("#tab-plots")
    drag(page, place_of(page, 0.2, 0.05), place_of(page, 0.0, 0.05))
    expect(page.locator("#notice")).to_have_text("unknown-1 has no name yet: name it, then drag it")
    expect(page.locator("[aria-label='Name of the parcel']")).to_be_focused()
    assert page.input_value("#chosen") == "parcel 1"
    assert table.done == []


def test_start_is_enabled_where_it_does_something_and_stops_always_are(still, open_page):
    _, address = still
    page = open_page(address)
    page.evaluate("page.show = () => page.wire.seen()")
    phases = page.evaluate("page.table.phases")
    enabled = {}
    for number, phase in enumerate(phases):
        page.evaluate(
            "(phase) => { page.snapshot.phase[0] = phase; page.showTexts(page.snapshot); }", number
        )
        enabled[phase] = page.is_enabled("#start")
        assert page.is_enabled("#stop")
        assert page.is_enabled("#stop-all")
    assert {phase for phase, on in enabled.items() if on} == {
        "no program",
        "stopped",
        "stopped after a fault",
    }


def test_stop_all_says_how_many_cells_are_off(still, open_page):
    table, address = still
    page = open_page(address)
    set_states = """(states) => {
      page.show = () => page.wire.seen();
      page.snapshot.cell_state.set(states);
      page.showTexts(page.snapshot);
    }"""
    page.evaluate(set_states, [3] * 18)
    page.click("#stop-all")
    expect(page.locator("#notice")).to_have_text("Stop all: 0 of 18 off")
    page.evaluate(set_states, [2] * 17 + [3])
    expect(page.locator("#notice")).to_have_text("Stop all: 17 of 18 off")
    page.evaluate(set_states, [2] * 18)
    expect(page.locator("#notice")).to_have_text("Stop all: 18 of 18 off")
    page.evaluate(set_states, [2] * 16 + [1, 3])
    page.click("#stop-all")
    expect(page.locator("#notice")).to_have_text(
        "Stop all: 16 of 18 off; cell 17 (node 17) does not answer: cut the motors' power",
        timeout=10_000,
    )
    assert table.done == [commands.StopAll()] * 2


def test_events_of_one_kind_are_counted_in_one_line(still, open_page):
    _, address = still
    page = open_page(address)
    page.click("#tab-events")
    page.evaluate("""() => {
      const at = (time_s, text, more = {}) => ({ time_s, what: "coordinator", text, ...more });
      const events = [at(0.5, "running")];
      for (let k = 0; k < 73; k++) {
        events.push(at(1 + k / 100, `cell ${k} reports 0x8250`, { trouble: true }));
      }
      events.push(at(2, "box has arrived"), at(2.5, "unknown-1 has arrived"), at(3, "stopped"));
      page.events.take({ events });
    }""")
    lines = page.locator("#event-list > li")
    expect(lines).to_have_count(4)
    texts = lines.all_inner_texts()
    assert "stopped" in texts[0]
    assert "\u00d72 unknown-1 has arrived" in texts[1]
    assert "\u00d773 cell 72 reports 0x8250" in texts[2]
    page.click("#event-list > li:nth-child(3) summary")
    expect(page.locator("#event-list > li:nth-child(3) details li")).to_have_count(72)
    page.fill("#filter", "cell 5")
    expect(page.locator("#event-list > li")).to_have_count(1)
    assert "\u00d711" in page.locator("#event-list > li").inner_text()


def test_cells_of_several_buses_have_their_full_names_on_a_phone(browser):
    opened = OpenPage(StillTable(9, 6))
    context = browser.new_context(viewport={"width": 390, "height": 760})
    page = context.new_page()
    page.add_init_script(SPY)
    page.goto(opened.page.address)
    wait_until(page, "Boolean(window.page?.snapshot && window.page.control)")
    page.evaluate("window.texts = []; page.picture.kept = ''; page.redraw()")
    page.wait_for_timeout(200)
    names = [text for text, *_ in page.evaluate("window.texts")][:54]
    context.close()
    opened.close()
    assert names == [f"{cell // 18}·{cell % 18 + 1}" for cell in range(54)]


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
