"""The drive of a cell: CiA 402 state machines around one speed loop."""
