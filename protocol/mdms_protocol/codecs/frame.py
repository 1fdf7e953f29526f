"""One classic CAN data frame, as everything above the bus sees it."""

from collections import namedtuple

#: `can_id` is the 11-bit identifier, `data` its 0 to 8 bytes.
Frame = namedtuple("Frame", ("can_id", "data"))
