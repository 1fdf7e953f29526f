"""The newest frame under each of some identifiers, as controllers with mailboxes keep it.

Frames that are read once a beat need no handling one by one. The background loop has the inbox sort
the frames of a turn into the boxes in one call. There they wait for their reader.
"""

# Receivers take the place of None, one by one.
# pyright: reportArgumentType=false, reportCallIssue=false

from array import array

LENGTH = 8
#: Below an identifier of 11 bits, in 16: the number of its box, or none.
BOX_BITS = 5
NO_BOX = (1 << BOX_BITS) - 1

# Numbers of `counts`
STAMP = 0  # the stamp of frames from now on
KNOWN = 1  # so many identifiers are taken


class Mailboxes:
    """Boxes for frames of eight bytes; those of another length are refused.

    `frames` has the data of box b from `LENGTH * b` on, and `stamps[b]` the stamp of the frame.
    `fresh[b]` is set until the reader clears it. `accepted` are all identifiers that the cell
    takes, in their order, with the numbers of their boxes; `counts[KNOWN]` of them.
    """

    def __init__(self, boxes, stamp):
        self.frames = bytearray(LENGTH * boxes)
        self.stamps = array("i", [stamp] * boxes)
        self.fresh = bytearray(boxes)
        self.counts = array("i", (stamp, 0))
        self.accepted = array("H")

    def listen(self, accepts):
        """Take over the cell's identifiers, each with the number of its box or another value."""
        accepted = []
        for can_id, served_by in accepts.items():
            box = served_by if isinstance(served_by, int) else NO_BOX
            accepted.append(can_id << BOX_BITS | box)
        accepted.sort()
        self.counts[KNOWN] = len(accepted)
        # In place, because the sorter holds on to the array.
        while len(self.accepted) < len(accepted):
            self.accepted.append(0)
        for place, entry in enumerate(accepted):
            self.accepted[place] = entry

    def put(self, box, data):
        """Put a frame into a box; returns False if its length is another."""
        if len(data) != LENGTH:
            return False
        start = LENGTH * box
        self.frames[start : start + LENGTH] = data
        self.stamps[box] = self.counts[STAMP]
        self.fresh[box] = 1
        return True
