"""The boards that cells report in 0x3030:3."""

from mdms_protocol.update import codes

NAMES = {
    codes.UNKNOWN_BOARD: "a board without a name of its own",
    codes.TEENSY41: "Teensy 4.1",
    codes.WEACT_H743: "WeAct MiniSTM32H743",
    codes.PYBV11: "PYBv1.1",
    codes.NUCLEO_G474RE: "NUCLEO-G474RE",
    codes.VIRTUAL: "virtual",
}
#: A beat of the neighbour layer takes most of their processor; docs/firmware.md, 'Figures'.
STEERED_BY_HOST = (codes.PYBV11, codes.NUCLEO_G474RE)


def cannot_steer(board: int) -> str | None:
    """Return why cells on a board cannot steer; None where they can."""
    if board not in STEERED_BY_HOST:
        return None
    return f'is a {NAMES[board]}, which is too slow to steer; set motion.control = "host"'
