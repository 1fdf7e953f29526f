"""The indices of all objects by name, as a module for cell and host.

A name is the object's own, or a shorter one of the code for a long name of the standard. Axis 2 and
all PDOs but the first go without: they lie at a fixed distance from the first.
"""

import re

from mdms_protocol.dictionary import AXIS_OFFSET, OBJECTS, PDOS

_SHORT = {
    0x1003: "ERROR_HISTORY",
    0x1005: "SYNC_COB_ID",
    0x1006: "CYCLE_PERIOD",
    0x1008: "DEVICE_NAME",
    0x1009: "HARDWARE_VERSION",
    0x100A: "SOFTWARE_VERSION",
    0x1010: "STORE",
    0x1011: "RESTORE",
    0x1014: "EMCY_COB_ID",
    0x1015: "EMCY_INHIBIT_TIME",
    0x1016: "CONSUMER_TIMES",
    0x1017: "PRODUCER_TIME",
    0x1018: "IDENTITY",
    0x1400: "RPDO_PARAMETERS",
    0x1600: "RPDO_MAPPING",
    0x1800: "TPDO_PARAMETERS",
    0x1A00: "TPDO_MAPPING",
    0x1F56: "PROGRAM_IDENTIFICATION",
    0x1F57: "FLASH_STATUS",
    0x3004: "BRAKING_TIME",
    0x3005: "SIGNATURE",
    0x3011: "NEIGHBOURS",
    0x3012: "SENSOR_OFFSETS",
    0x605E: "FAULT_REACTION",
    0x606B: "DEMAND",
    0x606C: "ACTUAL",
    0x606D: "WINDOW",
    0x606E: "WINDOW_TIME",
    0x6075: "RATED_CURRENT",
    0x6078: "CURRENT",
    0x6079: "SUPPLY",
    0x6083: "ACCELERATION",
    0x6084: "DECELERATION",
    0x6085: "QUICK_STOP",
    0x60FF: "TARGET",
}
_PDO_GROUPS = (0x1400, 0x1600, 0x1800, 0x1A00)
_REPEATED = {
    *(first + number for first in _PDO_GROUPS for number in range(1, PDOS)),
    *(each.index for each in OBJECTS if each.name.startswith("Axis 2 ")),
}


def names() -> dict[str, int]:
    """Indices by name, in their order. Raises ValueError where two objects have the same name."""
    found: dict[str, int] = {}
    for each in OBJECTS:
        if each.index in _REPEATED:
            continue
        name = _SHORT.get(each.index) or _derived(each.name)
        if name in found:
            raise ValueError(f"0x{found[name]:04X} and 0x{each.index:04X} are both called {name}")
        found[name] = each.index
    return found


def text() -> str:
    """The source of `mdms_protocol.indices`."""
    lines = [f"{name} = 0x{index:04X}" for name, index in names().items()]
    return "\n".join(
        (
            '"""Indices of the object table by name; see `generators`. Written by `generate`."""',
            "",
            "# From axis 1 to axis 2; from one PDO to the next it is 1.",
            f"AXIS_OFFSET = 0x{AXIS_OFFSET:X}",
            "",
            *lines,
            "",
        )
    )


def _derived(name: str) -> str:
    return re.sub(r"[^A-Z0-9]+", "_", name.removeprefix("Axis 1 ").upper())
