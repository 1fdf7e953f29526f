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
        self._served = [(_NOBODY, None)] * boxes

    def receiver(self, box, can_id):
        """What puts frames with this identifier into a box; it returns False if it refuses one."""

        # Defaults, not variables from around: MicroPython allocates at each call for those.
        def receive(data, put=self.put, box=box):
            return put(box, data)

        self._served[box] = can_id, receive
        return receive

    def listen(self, accepts):
        """Take over which identifiers the cell takes, and which of them a box still serves."""
        identifiers = [
            can_id if receive is not None and accepts.get(can_id) is receive else _NOBODY
            for can_id, receive in self._served
        ]
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
