"""The objects by which firmware comes over the bus (CiA 302-3), and those that a host reads before.

`codes` has the numbers that are written to them, and those that they report.
"""

from mdms_protocol import entry as e
from mdms_protocol.entry import DOMAIN, READ, U8, U16, U32, WRITE, Field, array, field, record

UPDATE_OBJECTS: dict[int, Field | e.Group] = {
    0x1F50: array("Program data", 1, field("Program", DOMAIN, WRITE)),
    0x1F51: array("Program control", 1, field("Control of program", U8, default=1)),
    0x1F56: array("Program software identification", 1, field("Identification", U32, READ)),
    0x1F57: array("Flash status identification", 1, field("Flash status", U32, READ)),
    0x3030: record(
        "Update",
        {
            1: field("Update key", DOMAIN, WRITE),
            2: field("Update key identification", U32, READ),
            3: field("Update board", U8, READ),
            4: field("Update bytecode", U16, READ),
            5: field("Update room", U32, READ),
            6: field("Update counter", U32, READ),
            7: field("Update slot", U8, READ),
            8: field("Update on trial", U8, READ),
        },
    ),
}
