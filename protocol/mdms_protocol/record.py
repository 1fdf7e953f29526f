"""How one entry of the object table lies in the packed form that a cell holds."""

#: index u16, sub-index u8, data type u8, flags u8, size u8, place u16, low i32, high i32
RECORD = "<HBBBBHii"

# Flags of a record
READABLE = 1
WRITABLE = 2
IN_RPDO = 4
IN_TPDO = 8
STORED_COMMUNICATION = 16
STORED_APPLICATION = 32
FROM_NODE = 64
LIMITED = 128
