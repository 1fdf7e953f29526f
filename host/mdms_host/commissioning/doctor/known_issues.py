"""Known issues of users of other boards and buses, and `docs/troubleshooting.md` made of them.

Each row names the tests that show how this project behaves; `tests` are paths from the project's
folder, with the function behind `::`. The page also has the table of findings.
"""

from dataclasses import dataclass
from textwrap import TextWrapper

from mdms_host.commissioning.doctor.findings import KINDS
from mdms_protocol.emergencies import CODES


@dataclass(frozen=True, slots=True)
class KnownIssue:
    """One trouble: where it was reported, its symptom, cause and cure, and our tests."""

    reported: tuple[str, ...]
    symptom: str
    cause: str
    cure: str
    tests: tuple[str, ...]


_FLASH = "tests/system/flashing/test_flash.py::"
_COMMISSION = "tests/host/cli/commission/test_commission.py::"
_BRING_UP = "tests/host/coordination/test_bring_up.py::"
_COORDINATOR = "tests/host/coordination/test_coordinator.py::"

PAINS = (
    KnownIssue(
        ("micropython/micropython#15946",),
        "Several boards are connected, and nobody can say which is which.",
        "Serial ports are numbered as boards are found, anew each time.",
        "mdms flash --list shows the serial number that each board has on the bus too, made of its "
        "chip's own; mdms identify has one blink, and mdms commission asks for each in turn.",
        (
            f"{_FLASH}test_list_for_people_has_the_serial_number_of_the_bus_and_compares_versions",
            "tests/host/cli/commission/test_places.py::test_each_cell_blinks_and_a_key_says_where_it_is",
        ),
    ),
    KnownIssue(
        ("Klipper3d/klipper#3902",),
        "Two nodes have one id, and a command goes to the wrong one.",
        "Ids were given by hand, or a board came from another table.",
        "A cell asks before it takes its id, and stays silent if a node answers (0x8150). A cell "
        "that meets a rival later switches its motors off. mdms commission gives each cell its "
        "own id, by serial numbers.",
        (
            "tests/both/canopen/test_claim.py::test_node_id_that_answers_is_not_taken_and_that_is_reported",
            "tests/both/canopen/test_guard.py::test_rival_that_comes_later_switches_the_motors_off",
            f"{_COMMISSION}test_two_cells_that_answer_under_one_node_id_both_get_their_own",
        ),
    ),
    KnownIssue(
        ("mjbots/moteus#13",),
        "Settings are gone after an update.",
        "The tool restores them but does not store them, or the new firmware has another layout.",
        "mdms flash writes files of the firmware alone and leaves settings where they are. They "
        "are stored object by object, so a firmware with other objects reads them too. mdms "
        "configure dump keeps them in a file. load --save writes, verifies and stores them again.",
        (
            f"{_FLASH}test_running_cell_is_stopped_flashed_and_runs_the_new_firmware",
            "tests/both/canopen/storage/test_store.py::"
            "test_settings_survive_a_firmware_that_has_other_objects_besides",
            "tests/host/cli/configure/test_configure.py::"
            "test_array_is_backed_up_and_restored_by_serial_number",
        ),
    ),
    KnownIssue(
        ("odriverobotics/ODrive#575",),
        "An update reports success, the version stays as it was, and settings are not restored.",
        "The flashed firmware was built with the old version. The tool took the transfer for "
        "success.",
        "The version comes from one module, which host and firmware share. mdms flash compares "
        "every file on the board by SHA-256 before it reports success. It reads the version from "
        "the board.",
        (
            f"{_FLASH}test_command_flashes_the_real_firmware_onto_boards_at_once",
            f"{_FLASH}test_file_that_flash_does_not_keep_is_named_and_the_firmware_does_not_start",
        ),
    ),
    KnownIssue(
        ("Factor-Robotics/odrive_ros2_control#2",),
        "After an update of one side nothing works, or wrongly.",
        "Host and firmware speak different versions of a protocol that changes with each.",
        "The protocol has a revision of its own (0x1018:3). A run refuses cells of another one by "
        "name, before anything is written to any cell; a later one that only adds is taken.",
        (
            f"{_BRING_UP}test_cells_of_another_protocol_are_named_and_nothing_is_written_to_any_cell",
            f"{_BRING_UP}test_a_later_revision_of_the_same_protocol_is_taken",
        ),
    ),
    KnownIssue(
        ("vedderb/bldc#836", "Arksine/katapult#111"),
        "An update over the bus 'succeeds', and after the restart the old firmware runs.",
        "All blocks were sent and answered, but another firmware starts. The new one was never "
        "put in place, or was given up at the start.",
        "An update by mdms flash --bus counts only once the cell has come up with it, has spoken "
        "to the host and has passed its self-test. Otherwise the cell goes back to the old "
        "firmware and reports it, and the update has failed. Bundles that are wrong, old, cut "
        "short or another array's are refused with the reason.",
        (
            "tests/system/flashing/test_update.py::test_whole_firmware_comes_over_the_bus_and_stays",
            "tests/system/flashing/test_update.py::test_firmware_that_crashes_makes_way_for_the_one_before",
            "tests/system/flashing/test_update.py::"
            "test_supply_may_fail_on_trial_and_the_firmware_before_comes_back",
            "tests/both/update/test_update.py::"
            "test_bundle_that_is_not_for_this_cell_is_refused_with_the_reason",
        ),
    ),
    KnownIssue(
        ("Klipper3d/klipper#214",),
        "Everything stops with an error that names no cause.",
        "Only the last link of the chain is reported.",
        "A fault names cell, axis and error code with its words, and stays on the cell until it is "
        "reset; mdms doctor has cause and cure for each.",
        (
            f"{_COORDINATOR}test_a_drive_that_trips_is_named_with_its_reason",
            "tests/host/commissioning/test_status.py::"
            "test_a_fault_from_before_is_named_with_its_words",
            "tests/both/drive/test_axes.py::"
            "test_fault_of_the_loop_is_reported_from_its_axis_until_it_is_reset",
        ),
    ),
    KnownIssue(
        ("Klipper3d/klipper#2900",),
        "'Lost communication', for no apparent reason, hours into a job.",
        "A supply that dips, or a computer that is held up. The bus only shows it.",
        "The end of a run names the late part: the computer, the bus or single cells. A dip of "
        "the supply is an emergency of its own (0x3220). mdms doctor shows cells whose supply is "
        "low or uneven.",
        (
            "tests/host/coordination/test_operation.py::test_a_fault_names_what_was_held_up",
            "tests/system/trouble/test_power.py::"
            "test_coordinator_reports_a_lost_supply_and_stops_the_array",
            "tests/system/commissioning/test_doctor.py::test_each_fault_is_found_at_its_cell_and_nothing_else",
        ),
    ),
    KnownIssue(
        ("hardbyte/python-can#2004",),
        "'No buffer space available', at once, though a time-out was given.",
        "The transmit queue of SocketCAN has room for ten frames, and a socket before it is always "
        "ready to be written to.",
        "Nothing to do: frames that do not fit are sent again for as long as a cycle takes. "
        "Frames that never left are counted and reported. A longer queue helps too (ip link set "
        "can0 txqueuelen 100).",
        (
            "tests/host/can_link/test_full_queue.py::"
            "test_a_cycle_that_is_longer_than_socketcans_queue_goes_out_whole",
            "tests/host/can_link/test_full_queue.py::"
            "test_a_queue_that_stays_full_is_shown_and_is_no_dead_device",
        ),
    ),
    KnownIssue(
        ("canopen-python/canopen#623",),
        "A transfer is aborted (0x05040000) though the node has answered in time.",
        "The answer came right behind a SYNC, and the reader lost it.",
        "Nothing to do: our own reader hands over every frame in its order.",
        (
            "tests/host/commissioning/test_network.py::"
            "test_answers_right_behind_a_sync_are_all_received",
        ),
    ),
    KnownIssue(
        ("CANopenNode/CanOpenSTM32#128",),
        "A node that was bus off stays silent until it is switched off and on.",
        "Controllers of the FDCAN kind do not leave bus-off by themselves: the program must "
        "restart them.",
        "Nothing to do: the cell cuts its motors (0x8140) and leaves the bus alone for 100 ms. "
        "Then it restarts the controller until the bus is back, and the host takes the cell back.",
        (
            "tests/firmware/boards/on_board_bus.py::test_bus_off_cuts_the_motors_and_the_bus_comes_back",
            "tests/firmware/boards/on_board_bus.py::test_bus_that_goes_off_again_is_tried_again_and_again",
            "tests/host/coordination/care/test_care.py::"
            "test_trouble_that_passes_is_a_pause_and_the_field_goes_on",
        ),
    ),
)


_HEAD = """\
# Troubleshooting

By symptom, in the order in which it pays to look. `mdms doctor` checks all of this and names the
nodes. Its exit code is 5 if it finds anything serious.

| option | checks |
| --- | --- |
| `--turn` | wheels: it turns each by some centimetres |
| `--empty` | sensors, on an empty table |
| `--array FILE` | missing cells, and settings |
| `--stop` | the emergency stop: it asks you to press and to release it; exit code 1 if it fails |

`make generate` makes this page from the same tables.
"""
_LINES = TextWrapper(100, subsequent_indent="  ", break_on_hyphens=False, break_long_words=False)
_PAINS = """\
## What others ran into

Reports of users of other boards, buses and libraries, and the behaviour of this project. The tests
show it. Those of `on_board_bus` run on MicroPython for each board, by `test_boards`.
"""


def troubleshooting_text() -> str:
    """The page."""
    parts = [_HEAD]
    for name, kind in KINDS.items():
        weight = "serious" if kind.serious else "a warning"
        parts.append(
            f"## {kind.symptom.rstrip('.')}\n`{name}`, {weight}.\n\n"
            f"{_item('Cause', kind.cause)}{_item('Cure', kind.cure)}"
        )
    parts += [_PAINS, *map(_pain, PAINS)]
    parts.append("## Error codes of cells\n" + _codes())
    return "\n".join(parts)


def _pain(pain: KnownIssue) -> str:
    tests = ", ".join(f"`{test}`" for test in pain.tests)
    return (
        f"### {pain.symptom.rstrip('.')}\n{', '.join(map(_reference, pain.reported))}\n\n"
        f"{_item('Cause', pain.cause)}{_item('Cure', pain.cure)}{_item('Tests', f'{tests}.')}"
    )


def _item(name: str, text: str) -> str:
    """One item of a list, in lines that a terminal shows whole."""
    return _LINES.fill(f"- **{name}.** {text}") + "\n"


def _reference(issue: str) -> str:
    repository, _, number = issue.partition("#")
    return f"[{issue}](https://github.com/{repository}/issues/{number})"


def _codes() -> str:
    rows = [f"| 0x{code:04X} | {text} |" for code, text in CODES.items()]
    return "\n".join(["| code | meaning |", "|---|---|", *rows]) + "\n"
