"""How entries of the object table lie in the packed form that a cell holds."""

#: index u16, first sub-index u8, data type and number of entries less one u8, flags u8, limits u8,
#: place u16. The values begin at `place` in the data and end where those of the next record begin.
RECORD = "<HBBBBH"
RECORD_SIZE = 8
FLAGS_AT = 4
COUNT_SHIFT = 4
TYPE = (1 << COUNT_SHIFT) - 1
RUN_MAX = 16
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
