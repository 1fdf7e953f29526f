"""Codes between host and cell about firmware: 0x1F50, 0x1F51, 0x1F57 and 0x3030.

CiA 302-3 names the objects, and leaves these codes to manufacturers.
"""

# What is written to 0x1F51:1
START = 1
RESET = 2
CLEAR = 3
#: The firmware on trial is to stay.
CONFIRM = 0x80

#: Where the firmware that runs lies (0x3030:7): as USB has brought it, or in a slot.
INSTALLED = 0
SLOTS = (1, 2)

# Boards by number (0x3030:3); in a bundle each is a bit.
UNKNOWN_BOARD = 0
TEENSY41 = 1
WEACT_H743 = 2
PYBV11 = 3
NUCLEO_G474RE = 4
VIRTUAL = 15
#: Of `sys.implementation._mpy`, what compiled modules have to agree with.
BYTECODE = 0x3FFF

#: Bytes of an array's key, and of the code by which a bundle proves that its maker has it.
KEY_SIZE = 32

# Why a cell refuses (0x1F57:1, bits 16 to 31)
NO_ROOM = 1
NO_KEY = 2
NO_BUNDLE = 3
FOREIGN = 4
FORGED = 5
OTHER_BOARD = 6
OTHER_BYTECODE = 7
OLDER = 8
REPLAYED = 9
TOO_LARGE = 10
TRUNCATED = 11
DAMAGED = 12
DRIVING = 13
FLASH_FAILED = 14
NOT_CLEARED = 15
NOTHING_TO_START = 16
NOT_ON_TRIAL = 17
SELF_TEST = 18
ROLLED_BACK = 19
OTHER_KEY = 20
ON_TRIAL = 21

# 0x1F57:1, the errors of CiA 302-3 (bits 1 to 7) that the reasons are reported as
_NO_PROGRAM = 1
_UNKNOWN_FORMAT = 2
_DAMAGED_DATA = 3
_NOT_CLEARED = 4
_WRITE_FAILED = 5
_DENIED = 7
_OTHER = 63
BUSY = 1
_ERRORS = {
    0: 0,
    NO_BUNDLE: _UNKNOWN_FORMAT,
    TRUNCATED: _DAMAGED_DATA,
    DAMAGED: _DAMAGED_DATA,
    NOT_CLEARED: _NOT_CLEARED,
    FLASH_FAILED: _WRITE_FAILED,
    NOTHING_TO_START: _NO_PROGRAM,
    NO_KEY: _DENIED,
    FOREIGN: _DENIED,
    FORGED: _DENIED,
    OTHER_KEY: _DENIED,
}


def status(reason: int, busy: bool) -> int:
    """The value of 0x1F57:1."""
    return reason << 16 | _ERRORS.get(reason, _OTHER) << 1 | (BUSY if busy else 0)


def reason_of(number: int) -> int:
    """The reason that 0x1F57:1 gives, 0 for none."""
    return number >> 16
