"""CANopen services of a cell: CiA 301 and CiA 305."""
