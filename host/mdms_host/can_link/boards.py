"""The boards that cells report in 0x3030:3."""

from mdms_protocol.codecs import update

NAMES = {
    update.UNKNOWN_BOARD: "a board without a name of its own",
    update.TEENSY41: "Teensy 4.1",
    update.WEACT_H743: "WeAct MiniSTM32H743",
    update.PYBV11: "PYBv1.1",
    update.NUCLEO_G474RE: "NUCLEO-G474RE",
    update.VIRTUAL: "virtual",
}
#: A beat of the neighbour layer takes most of their processor; docs/firmware.md, 'Figures'.
STEERED_BY_HOST = (update.PYBV11, update.NUCLEO_G474RE)


def cannot_steer(board: int) -> str | None:
    """Return why cells on a board cannot steer; None where they can."""
    if board not in STEERED_BY_HOST:
        return None
    return f'is a {NAMES[board]}, which is too slow to steer; set motion.control = "host"'
