"""A board as an SLCAN adapter: CAN on one side, a serial line over USB on the other."""
