"""The newest frame under each of some identifiers, as controllers with mailboxes keep it.

What is looked at once a beat need not be handled frame by frame: the background loop has the inbox
sort a whole turn's frames in one call, into the boxes, and nothing more happens to them until
somebody reads.
"""

# Receivers take the place of None, one by one.
# pyright: reportArgumentType=false, reportCallIssue=false

from array import array

LENGTH = 8
#: In the place of an identifier: a box that no frame is for.
_NOBODY = 0xFFFF

# Numbers of `counts`
STAMP = 0  # what frames are stamped with from now on
BOXES = 1  # so many of the identifiers have a box
KNOWN = 2  # so many identifiers are taken at all


class Mailboxes:
    """Boxes for frames of eight bytes; those of another length are refused.

    Of box b, `frames` has the data from `LENGTH * b` on, `stamps[b]` what the frame was stamped
    with, and `fresh[b]` is set until who reads it clears it. `identifiers` begins with those of the
    boxes, and goes on with all that the cell takes.
    """

    def __init__(self, boxes, stamp):
        self.frames = bytearray(LENGTH * boxes)
        self.stamps = array("i", [stamp] * boxes)
        self.fresh = bytearray(boxes)
        self.counts = array("i", (stamp, boxes, 0))
        self.identifiers = array("H")

    def listen(self, accepts):
        """Take over what the cell takes: by identifier the number of a box, or anything else."""
        identifiers = [_NOBODY] * len(self.fresh)
        for can_id, served_by in accepts.items():
            if isinstance(served_by, int):
                identifiers[served_by] = can_id
        identifiers.extend(accepts)
        self.identifiers = array("H", identifiers)
        self.counts[KNOWN] = len(identifiers)

    def put(self, box, data):
        """Put a frame into a box; returns False if its length is another."""
        if len(data) != LENGTH:
            return False
        start = LENGTH * box
        self.frames[start : start + LENGTH] = data
        self.stamps[box] = self.counts[STAMP]
        self.fresh[box] = 1
        return True
