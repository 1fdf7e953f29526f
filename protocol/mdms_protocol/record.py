"""How one entry of the object table lies in the packed form that a cell holds."""

#: index u16, sub-index u8, data type u8, flags u8, limits u8, place u16. The value begins at
#: `place` in the data and ends where that of the next record begins.
RECORD = "<HBBBBH"
RECORD_SIZE = 8
#: low i32, high i32; `limits` counts these from 1, 0 are those of the type.
LIMITS = "<ii"
LIMITS_SIZE = 8

# Flags of a record
READABLE = 1
WRITABLE = 2
IN_RPDO = 4
IN_TPDO = 8
STORED_COMMUNICATION = 16
STORED_APPLICATION = 32
FROM_NODE = 64
