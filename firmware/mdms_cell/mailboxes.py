"""The newest frame under each of some identifiers, as controllers with mailboxes keep it.

What is looked at once a beat need not be handled frame by frame: the background loop has the inbox
sort a whole turn's frames in one call, into the boxes, and nothing more happens to them until
somebody reads.
"""

# Receivers take the place of None, one by one.
# pyright: reportArgumentType=false, reportCallIssue=false

from array import array

LENGTH = 8
#: Below an identifier of 11 bits, in 16: the number of its box, or none.
BOX_BITS = 5
NO_BOX = (1 << BOX_BITS) - 1

# Numbers of `counts`
STAMP = 0  # what frames are stamped with from now on
KNOWN = 1  # so many identifiers are taken


class Mailboxes:
    """Boxes for frames of eight bytes; those of another length are refused.

    Of box b, `frames` has the data from `LENGTH * b` on, `stamps[b]` what the frame was stamped
    with, and `fresh[b]` is set until who reads it clears it. `accepted` are the identifiers of all
    that the cell takes, in their order, with the numbers of their boxes; `counts[KNOWN]` of them.
    """

    def __init__(self, boxes, stamp):
        self.frames = bytearray(LENGTH * boxes)
        self.stamps = array("i", [stamp] * boxes)
        self.fresh = bytearray(boxes)
        self.counts = array("i", (stamp, 0))
        self.accepted = array("H")

    def listen(self, accepts):
        """Take over what the cell takes: by identifier the number of a box, or anything else."""
        accepted = []
        for can_id, served_by in accepts.items():
            box = served_by if isinstance(served_by, int) else NO_BOX
            accepted.append(can_id << BOX_BITS | box)
        accepted.sort()
        self.counts[KNOWN] = len(accepted)
        # In place, for who sorts holds on to the array.
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
