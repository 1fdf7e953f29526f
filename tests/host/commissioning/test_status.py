import io

import pytest
from rich.console import Console

from mdms_host.commissioning.network import Identity
from mdms_host.commissioning.status import (
    NEIGHBOURS,
    CellStatus,
    FoundNode,
    StatusModel,
    scan_table,
    status_table,
)
from mdms_protocol.codecs import sdo
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.dictionary import PRODUCT_CODE, VENDOR_ID

WORD, PRESENCE, SUSPECT, REGISTER = 0x6041, 0x3001, 0x3015, 0x1001


def answer(index: int, sub: int, value: int) -> Frame:
    place = index.to_bytes(2, "little") + bytes((sub,))
    return Frame(0x585, b"\x43" + place + value.to_bytes(4, "little"))


def after(*frames: Frame) -> StatusModel:
    """A model that has heard these frames, one a millisecond, with a poll after each."""
    model = StatusModel()
    for number, frame in enumerate(frames):
        model.on_frame(frame, number / 1000)
        list(model.poll(number / 1000))
    return model


#: A cell of ours that knows no neighbours.
ALONE = {(0x1018, 1): VENDOR_ID, (0x1018, 2): PRODUCT_CODE} | dict.fromkeys(NEIGHBOURS, 0)
#: A cell at rest, whose drives are off.
AT_REST = {WORD: 0x40, 0x6841: 0x40, PRESENCE: 0, 0x603F: 0, 0x683F: 0, SUSPECT: 0, REGISTER: 0}


def asked(model: StatusModel, replies: dict[int, int | None], start_s: float = 0.0) -> list[Frame]:
    """The requests of the model to node 5, which replies so; None is a refusal."""
    requests = []
    for step in range(40):
        now_s = start_s + step / 200
        for frame in model.poll(now_s):
            if frame.can_id != 0x605:
                continue
            requests.append(frame)
            index = frame.data[1] | frame.data[2] << 8
            sub = frame.data[3]
            value = ALONE[index, sub] if sub else (AT_REST | replies)[index]
            refusal = Frame(0x585, sdo.abort(index, sub, sdo.NO_SUCH_OBJECT))
            model.on_frame(refusal if value is None else answer(index, sub, value), now_s)
    return requests


def text(model: StatusModel, now_s: float) -> str:
    console = Console(file=io.StringIO(), width=120)
    console.print(status_table(model.rows(now_s)))
    return console.file.getvalue()


def test_a_cell_that_appears_is_asked_once() -> None:
    model = StatusModel()
    model.on_frame(Frame(0x705, b"\x7f"), 0.0)
    assert len(asked(model, {0x6841: 0x27, PRESENCE: 0b10001})) == 17
    model.on_frame(Frame(0x705, b"\x7f"), 0.2)
    assert asked(model, {}, 0.2) == []
    (row,) = model.rows(0.2)
    assert row.drives == ("switch on disabled", "operation enabled")
    assert row.presence == 0b10001
    assert "●○○○●" in text(model, 0.2)


@pytest.mark.parametrize(("refused", "code"), [(SUSPECT, 0x7121), (PRESENCE, None)])
def test_a_refused_object_hides_no_fault(refused: int, code: int | None) -> None:
    model = StatusModel()
    model.on_frame(Frame(0x705, b"\x7f"), 0.0)
    asked(model, {WORD: 0x08, 0x603F: 0x7121, refused: None})
    (row,) = model.rows(0.2)
    assert row.drives == ("fault", "switch on disabled")
    assert (row.in_fault, row.emergency) == (True, code)


def test_changes_that_cells_tell_are_shown() -> None:
    speeds = (12_300).to_bytes(4, "little") + (-500).to_bytes(4, "little", signed=True)
    model = after(
        Frame(0x705, b"\x05"),
        Frame(0x285, bytes((0x27, 0, 0x08, 0, 0b00100))),
        Frame(0x185, speeds),
        Frame(0x085, bytes.fromhex("3081000000000000")),
    )
    (row,) = model.rows(0.1)
    assert row.state == "operational"
    assert row.drives == ("operation enabled", "fault")
    assert row.speeds_m_s == pytest.approx((0.0123, -0.0005))
    shown = text(model, 0.1)
    assert "○○●○○" in shown
    assert "12.3" in shown
    assert "0x8130: heartbeat of the host lost" in " ".join(shown.split())


def test_a_cell_that_falls_silent_is_shown_so() -> None:
    model = after(Frame(0x705, b"\x05"), Frame(0x706, b"\x05"))
    model.on_frame(Frame(0x706, b"\x05"), 1.0)
    assert [row.silent for row in model.rows(1.1)] == [True, False]
    assert "silent 1.1 s" in text(model, 1.1)


def test_a_cell_that_was_stopped_is_read_anew_and_not_shown_as_it_was() -> None:
    speeds = (250_000).to_bytes(4, "little") * 2
    model = after(
        Frame(0x705, b"\x05"),
        Frame(0x285, bytes((0x27, 0, 0x27, 0, 0b11111))),
        Frame(0x185, speeds),
        Frame(0x705, b"\x7f"),
    )
    (row,) = model.rows(0.1)
    assert (row.drives, row.speeds_m_s, row.presence) == (None, None, None)
    assert len(asked(model, {PRESENCE: 1}, 0.1)) == 17
    (row,) = model.rows(0.5)
    assert (row.state, row.drives) == ("pre-operational", ("switch on disabled",) * 2)
    assert (row.speeds_m_s, row.presence) == (None, 1)


def test_a_frame_of_no_cell_adds_no_row() -> None:
    model = after(Frame(0x77F, b"\x05"), Frame(0x205, bytes(8)), Frame(0x000, b"\x01\x00"))
    assert model.rows(0.1) == []


def test_a_node_that_gives_no_answer_is_left_in_peace() -> None:
    model = StatusModel()
    model.on_frame(Frame(0x705, b"\x7f"), 0.0)
    requests = [frame for step in range(500) for frame in model.poll(step / 100)]
    assert len(requests) == 3
    assert model.rows(5.0)[0].drives is None


def test_nothing_is_asked_while_firmware_comes_in() -> None:
    """Block 3 of node 6 is acknowledged; a request to node 5 may meet a transfer, too."""
    model, block = StatusModel(), Frame(0x586, b"\xa2\x3f\x3f" + bytes(5))
    asked_s = []
    for step in range(60):
        now_s = step / 10
        model.on_frame(Frame(0x705, b"\x7f"), now_s)
        if step in (1, 15):
            model.on_frame(block, now_s)
        asked_s += [now_s for _ in model.poll(now_s)]
    assert model.update_ran
    assert asked_s[0] == pytest.approx(3.5)


def test_a_fault_from_before_is_named_with_its_words() -> None:
    """The emergency went out before anybody listened."""
    model = StatusModel()
    model.on_frame(Frame(0x705, b"\x05"), 0.0)
    asked(model, {WORD: 0x27, 0x6841: 0x08, 0x603F: 0x8250, 0x683F: 0x7121, REGISTER: 0x21})
    (row,) = model.rows(0.1)
    assert row.errors == ("0x7121: wheel stands under voltage: stalled (axis 2)",)
    assert row.emergency == 0x7121


def test_an_error_that_is_gone_is_no_longer_shown_and_others_stay() -> None:
    model = after(
        Frame(0x705, b"\x05"),
        Frame(0x085, bytes.fromhex("5082110100000000")),
        Frame(0x085, bytes.fromhex("3081110300000000")),
        Frame(0x085, bytes.fromhex("0000110300000000")),
    )
    (row,) = model.rows(0.1)
    assert row.errors == ("0x8250: no setpoint for 50 ms (axis 1)",)
    model.on_frame(Frame(0x705, b"\x00"), 0.1)
    assert model.rows(0.1)[0].errors == ()


def test_a_suspect_is_shown_with_the_cells_that_it_contradicts_until_it_agrees() -> None:
    model = after(
        *(Frame(0x700 + node, b"\x05") for node in (5, 6, 7)),
        Frame(0x085, bytes.fromhex("01ff810907010000")),
        Frame(0x086, bytes.fromhex("01ff810907010000")),
    )
    assert [row.suspected_by for row in model.rows(0.1)] == [(), (), (5, 6)]
    shown = " ".join(text(model, 0.1).split())
    assert "suspected by node 5, 6" in shown
    assert "0xFF01: a neighbour contradicts, and is left out" in shown
    model.on_frame(Frame(0x085, bytes.fromhex("0000000900000000")), 0.1)
    model.on_frame(Frame(0x706, b"\x00"), 0.1)
    assert [row.suspected_by for row in model.rows(0.1)] == [(), (), ()]


def test_a_suspect_from_before_is_read() -> None:
    model = StatusModel()
    for node in (5, 7):
        model.on_frame(Frame(0x700 + node, b"\x05"), 0.0)
    asked(model, {WORD: 0x27, 0x6841: 0x27, SUSPECT: 7, REGISTER: 0x81})
    assert [(row.suspected_by, row.in_fault) for row in model.rows(0.1)] == [
        ((), False),
        ((5,), True),
    ]


def test_a_cell_in_anothers_place_from_before_is_named() -> None:
    """Its emergency went out at its boot. A suspicion sets the same bit, and names a suspect."""
    model = StatusModel()
    model.on_frame(Frame(0x705, b"\x7f"), 0.0)
    asked(model, {REGISTER: 0x81})
    (row,) = model.rows(0.1)
    assert row.errors == ("0xFF02: it stands in the place of another cell, and does not start",)


def test_table_names_the_unit_and_fits_80_columns() -> None:
    speeds = (-123_400).to_bytes(4, "little", signed=True) * 2
    frames = [
        frame
        for node in range(1, 19)
        for frame in (
            Frame(0x700 + node, b"\x7f"),
            Frame(0x280 + node, bytes((0x40, 0, 0x40, 0, 0b00100))),
            Frame(0x180 + node, speeds),
        )
    ]
    console = Console(file=io.StringIO(), width=80)
    console.print(status_table(after(*frames).rows(0.06)))
    lines = [line for line in console.file.getvalue().splitlines() if line.strip()]
    assert len(lines) == 18 + 2
    assert "mm/s" in lines[0]
    assert "pre-operational" in lines[2]
    assert "switch on disabled" in lines[2]
    assert "-123.4 -123.4" in lines[2]


@pytest.mark.parametrize(
    ("width", "bus"), [(40, None), (40, "can1"), (80, "/dev/serial/by-id/usb-adapter_0001")]
)
def test_a_narrow_table_cuts_nothing_and_names_each_node(width, bus) -> None:
    rows = [
        CellStatus(
            *(node, "operational", 0.0, ("operation enabled",) * 2, 0, (0.06, -0.06), None),
            errors=("supply voltage too low",),
            bus=bus,
        )
        for node in (7, 113)
    ]
    console = Console(file=io.StringIO(), width=width)
    console.print(status_table(rows))
    shown = console.file.getvalue()
    assert {"7", "113"} <= set(shown.split())
    assert "…" not in shown
    found = FoundNode(113, "operational", Identity("MDMS cell", "1.0", 1, 2, 3, 0xABCDEF), None)
    console.print(scan_table({bus or "can0": [found], "can9": []}))
    assert "…" not in console.file.getvalue()
