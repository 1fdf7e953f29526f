"""The differences where the cells steer: places, heartbeats, and the end."""

from itertools import pairwise

from tests.host.coordination.arrays import BOTTOM, LAYOUT, still

from mdms_array.host import Cells, coordinator_of, layout_of
from mdms_cell.canopen.objects import Objects
from mdms_cell.canopen.sdo_server import SdoServer
from mdms_host.can_link.sdo_client import Setting
from mdms_host.coordination.cell_setup import HEARTBEAT_LIMIT_MS, Identification
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.run_state import Phase
from mdms_host.places import all_values
from mdms_model.buses import WATCHED_HEARTBEAT_S
from mdms_model.scenario.file import load_scenario
from mdms_protocol import indices, pdo, record
from mdms_protocol.codecs import cia402, cob, update
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.neighbours import messages


def tell_place(array, row: int) -> None:
    """All cells believe to stand in this row, with node 9 in the east."""
    for cell in array.cells:
        cell.objects.put(indices.PLACE, 1, 1)
        cell.objects.put(indices.PLACE, 2, row)
        cell.objects.put(indices.NEIGHBOURS, 1, 9)


def test_place_that_a_cell_was_told_does_not_matter_where_the_host_steers(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, still())
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    tell_place(array, row=7)
    array.run(coordinator, 3.0, lambda: coordinator.phase == Phase.RUNNING)
    assert coordinator.phase == Phase.RUNNING
    assert {cell.objects.number(indices.PLACE, 2) for cell in array.cells} == {7}
    assert {cell.objects.number(indices.CONTROL) for cell in array.cells} == {0}


def test_right_places_cost_no_reading_of_all_settings(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, still())
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    for number, cell in enumerate(array.cells, 1):
        for place, value in all_values(LAYOUT, number).items():
            cell.objects.put(*place, value)
    array.run(coordinator, 3.0, lambda: coordinator.phase == Phase.RUNNING)
    assert coordinator.phase == Phase.RUNNING
    assert all(len(cell.reads) < 10 for cell in array.cells)


def test_cells_that_steer_are_told_their_places_whatever_they_had(rolling_array) -> None:
    coordinator = coordinator_of(load_scenario("neighbours"), Cells())
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    tell_place(array, row=7)
    array.run(coordinator, 3.0, lambda: coordinator.phase == Phase.RUNNING)
    assert coordinator.phase == Phase.RUNNING
    for number, cell in enumerate(array.cells, 1):
        for place, value in all_values(layout_of(load_scenario("neighbours")), number).items():
            assert cell.objects.number(*place) == value
        assert cell.objects.number(indices.CONTROL) == 1
        written = [int.from_bytes(data[1:3], "little") for data in cell.writes]
        assert written[-1] == indices.CONTROL


def run_with_slow_boards(rolling_array, coordinator):
    """The array after a run on which the boards of cells 3 and 17 are too slow to steer."""
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    array.cells[2].objects.put(indices.UPDATE, 3, update.PYBV11)
    array.cells[16].objects.put(indices.UPDATE, 3, update.NUCLEO_G474RE)
    array.run(coordinator, 3.0, lambda: coordinator.stopped or coordinator.phase == Phase.RUNNING)
    return array


def test_boards_that_cannot_steer_are_named_and_nothing_is_written_to_any_cell(
    rolling_array,
) -> None:
    coordinator = coordinator_of(load_scenario("neighbours"), Cells())
    array = run_with_slow_boards(rolling_array, coordinator)
    assert coordinator.fault == (
        "cell 17 (node 17): each is a NUCLEO-G474RE, which is too slow to steer; "
        'set motion.control = "host"; '
        "cell 3 (node 3): each is a PYBv1.1, which is too slow to steer; "
        'set motion.control = "host"'
    )
    assert coordinator.phase == Phase.FAILED
    assert not any(cell.writes for cell in array.cells)
    assert all(cell.states == [cia402.SWITCH_ON_DISABLED] * 2 for cell in array.cells)


def test_the_host_steers_any_board(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, still())
    run_with_slow_boards(rolling_array, coordinator)
    assert coordinator.phase == Phase.RUNNING


def test_cell_that_comes_back_with_a_board_that_cannot_steer_is_not_taken() -> None:
    kept = Setting(indices.TPDO_PARAMETERS + 1, 5, 200)
    identification = Identification(1, axes=2, kept=kept, asks_board=True)
    objects = Objects()
    objects.put(indices.UPDATE, 3, update.NUCLEO_G474RE)
    objects.reset(1, record.FROM_NODE)
    server = SdoServer(objects, identification.on_response)
    for _ in range(3):
        for frame in identification.poll(0.0):
            server.on_request(frame.data)
    assert identification.done
    assert identification.refusal == (
        'it is a NUCLEO-G474RE, which is too slow to steer; set motion.control = "host"'
    )


def test_cell_that_was_left_to_steer_by_itself_is_made_to_obey(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, still())
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    left = array.cells[2].objects
    left.put(indices.CONTROL, 0, 1)
    left.put(indices.LEASE, 3, 1)
    left.put(indices.CONSUMER_TIMES, 1, 127 << 16 | 75)
    array.run(coordinator, 3.0, lambda: coordinator.phase == Phase.RUNNING)
    assert coordinator.phase == Phase.RUNNING
    for place in ((indices.CONTROL, 0), (indices.LEASE, 3), (indices.CONSUMER_TIMES, 1)):
        assert left.number(*place) == 0


def test_settings_of_a_run_that_cells_steer_are_taken_back_at_its_end(rolling_array) -> None:
    coordinator = coordinator_of(load_scenario("neighbours"), Cells())
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    array.run(coordinator, 3.0, lambda: coordinator.phase == Phase.RUNNING)
    coordinator.stop()
    array.run(coordinator, array.now_s + 1.0, lambda: coordinator.stopped)
    assert coordinator.stopped
    for cell in array.cells:
        for place in ((indices.CONTROL, 0), (indices.LEASE, 3), (indices.CONSUMER_TIMES, 1)):
            assert cell.objects.number(*place) == 0


def test_cells_that_steer_and_hear_no_stop_are_not_said_to_be_off(rolling_array) -> None:
    coordinator = coordinator_of(load_scenario("neighbours"), Cells())
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    array.run(coordinator, 3.0, lambda: coordinator.phase == Phase.RUNNING)
    poll, coordinator.poll = coordinator.poll, lambda now_s: poll(now_s)[:0]
    coordinator.stop()
    array.run(coordinator, array.now_s + 1.0, lambda: coordinator.stopped)
    assert coordinator.phase == Phase.FAILED
    assert coordinator.fault == "not confirmed to be off: all 18 cells; cut the motors' power"


def test_programs_end_behind_the_quick_stop(rolling_array) -> None:
    coordinator = coordinator_of(load_scenario("neighbours"), Cells())
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    array.run(coordinator, 3.0, lambda: coordinator.phase == Phase.RUNNING)
    coordinator.stop()
    frames = coordinator.poll(array.now_s)
    end = frames.index(Frame(cob.PROGRAM, messages.encode_page(messages.End(1, 1))))
    stops = [place for place, frame in enumerate(frames) if is_quick_stop(frame)]
    assert len(stops) == LAYOUT.cells
    assert max(stops) < end


def is_quick_stop(frame: Frame) -> bool:
    words = (cia402.QUICK_STOP,) * len(pdo.CONTROLWORD.entries)
    return frame.data == pdo.CONTROLWORD.encode(words)


def test_host_sends_heartbeats_often_enough_for_cells_that_steer(rolling_array) -> None:
    coordinator = coordinator_of(load_scenario("neighbours"), Cells())
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    array.run(coordinator, 3.0, lambda: coordinator.phase == Phase.RUNNING)
    at_ms = [
        step
        for step in range(300)
        for frame in coordinator.poll(array.now_s + 0.001 * step)
        if frame.can_id == cob.HEARTBEAT_BASE + 127
    ]
    assert len(at_ms) > 10
    assert {later - ms for ms, later in pairwise(at_ms)} == {24}
    # Two in a row may get lost, and the next be late.
    assert 3 * WATCHED_HEARTBEAT_S + 0.002 < 1e-3 * HEARTBEAT_LIMIT_MS
    limits = {cell.objects.number(indices.CONSUMER_TIMES, 1) for cell in array.cells}
    assert limits == {127 << 16 | 75}


def test_cells_that_steer_are_left_to_enable_their_drives(rolling_array) -> None:
    coordinator = coordinator_of(load_scenario("neighbours"), Cells())
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    array.run(coordinator, 3.0, lambda: coordinator.phase == Phase.RUNNING)
    array.run(coordinator, array.now_s + 0.5)
    assert coordinator.fault is None
    assert all(cell.states == [cia402.SWITCHED_ON] * 2 for cell in array.cells)
