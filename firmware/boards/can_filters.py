"""The acceptance filters of the CAN controllers, set for the identifiers that a cell takes."""

from machine import CAN

#: A filter that no frame passes, for CAN 2.0 allows no identifier that begins with seven recessive
#: bits. A bxCAN has no filter that lets nothing through, and frames that pass this one would keep
#: the interrupt waiting: they come into the second FIFO.
_NONE = (0x1FFFFFFF, 0x1FFFFFFF, CAN.FLAG_EXT_ID)
_EXACT = 0x7FF
_BITS = 11
#: Half of the 14 banks of a bxCAN, and of the 28 and 64 standard filters of an STM32G4's and H7's
#: FDCAN.
_BXCAN_PLACES = 7
_FDCAN_PLACES = 14
_FDCAN_H7_PLACES = 32


def bxcan(identifiers):
    """Filters of a bxCAN for these identifiers, all of them into the first FIFO.

    MicroPython gives filters at odd places to the second FIFO. Its interrupt looks at the second
    FIFO only after it has slept for a frame in the first. Standard and extended filters count
    together.
    """
    made = []
    for can_id, mask in shared(identifiers, _BXCAN_PLACES):
        made += ((can_id, mask, 0), _NONE)
    return made


def fdcan(identifiers, places=_FDCAN_PLACES):
    """Filters of an FDCAN that let these identifiers through, all of them into the first FIFO.

    MicroPython gives filters at odd places to the second FIFO, where frames would overtake others.
    Standard and extended filters count apart, so that each filter stands twice: the first decides.
    """
    made = []
    for can_id, mask in shared(identifiers, places):
        made += ((can_id, mask, 0), (can_id, mask, 0))
    return made


def fdcan_h7(identifiers):
    """As `fdcan`, for an STM32H7, which has more of them."""
    return fdcan(identifiers, _FDCAN_H7_PLACES)


def shared(identifiers, places):
    """Identifiers and masks that fit into so many places.

    Where there are more identifiers than places, those that differ least share one, and the cell
    drops what else comes through with them. None instead of identifiers lets all through.
    """
    if identifiers is None:
        return [(0, 0)]
    wanted = [(can_id, _EXACT) for can_id in sorted(identifiers)]
    bits = _BITS
    while len(wanted) > places:
        bits = _join(wanted, bits)
    return wanted


def _join(wanted, limit):
    """Have the best two masks share one place; return how many bits the shared mask compares.

    The best two leave most bits of a mask. The last two left `limit` bits, and no two leave more: a
    joined mask has fewer bits in common with all others. So the first two with `limit` bits will
    do.
    """
    most = -1
    best = 0, 1, 0
    for place in range(1, len(wanted)):
        for other in range(place):
            mask = _common(wanted[other], wanted[place])
            bits = bin(mask).count("1")
            if bits > most:
                most = bits
                best = other, place, mask
                if most == limit:
                    break
        if most == limit:
            break
    other, place, mask = best
    del wanted[place]
    wanted[other] = wanted[other][0] & mask, mask
    return most


def _common(one, two):
    return one[1] & two[1] & ~(one[0] ^ two[0])
