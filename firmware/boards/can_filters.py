"""The CAN controller's filters, loaded when it changes what a cell listens to."""

from machine import CAN

#: A filter that no frame of the bus passes.
_NONE = (0x1FFFFFFF, 0x1FFFFFFF, CAN.FLAG_EXT_ID)
#: Half of what an STM32F4 has: MicroPython gives those at odd places to the second FIFO.
_PLACES = 7


def filters(identifiers):
    """What lets frames with these identifiers through, all of them into the first FIFO.

    MicroPython's controller of an STM32F4 sleeps, in the interrupt, for a frame of the first FIFO
    before it looks at the second, so nothing may come there. Where there are more identifiers than
    places, those that differ least share one, and the cell drops what else comes through with them.
    """
    wanted = [(can_id, 0x7FF) for can_id in sorted(identifiers)]
    while len(wanted) > _PLACES:
        _join(wanted)
    made = []
    for can_id, mask in wanted:
        made += ((can_id, mask, 0), _NONE)
    return made


def _join(wanted):
    """Have the two that leave most bits of a mask share one place."""
    most = -1
    best = 0, 1, 0
    for place in range(1, len(wanted)):
        for other in range(place):
            mask = _shared(wanted[other], wanted[place])
            bits = bin(mask).count("1")
            if bits > most:
                most = bits
                best = other, place, mask
    other, place, mask = best
    del wanted[place]
    wanted[other] = wanted[other][0] & mask, mask


def _shared(one, two):
    return one[1] & two[1] & ~(one[0] ^ two[0])
