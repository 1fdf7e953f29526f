"""Whether a layout is well-formed, so that there is a plan for it.

It is when there is an order in which each parcel has a way past the tiles under the goals of those
before it and the starts of those after it: planned in this order each finds a route, for at worst
it waits until those before it have come to their goals.
"""

from collections.abc import Callable, Mapping, Sequence
from random import Random

from mdms_host.routes.errand import Errand
from mdms_model.arrays import Bools, Ints

Free = Callable[[Errand, Bools], bool]


#: So many orders are built before the search for one is given up.
_TRIES = 12


def order_of(errands: Mapping[str, Errand], closed: Bools, free: Free) -> tuple[str, ...] | None:
    """An order in which the parcels with goals could go one after another; None: none was found.

    Orders are built by turns from the last to the first and from the first to the last, each time
    of the parcels in another sequence.
    """
    moving = [name for name, errand in errands.items() if errand.task.goal is not None]
    standing = [errand.stand for errand in errands.values() if errand.task.goal is None]
    closed = _with(closed, standing)
    random = Random("orders")
    for number in range(_TRIES):
        order = _built(errands, moving, closed, free, number % 2 == 0)
        if len(order) == len(moving):
            return order
        moving = random.sample(moving, len(moving))
    return None


def _built(
    errands: Mapping[str, Errand], moving: Sequence[str], closed: Bools, free: Free, backward: bool
) -> tuple[str, ...]:
    """As much of an order as comes of taking whoever can be the last, or the first, of the rest."""
    order: list[str] = []
    rest = list(moving)
    while rest:
        before = len(order)
        for name in tuple(rest):
            others = [errands[other] for other in rest if other != name]
            ordered = [errands[other] for other in order]
            earlier, later = (others, ordered) if backward else (ordered, others)
            stands = [errand.goal_stand for errand in earlier]
            stands += [errand.stand for errand in later]
            if free(errands[name], _with(closed, stands)):
                order.append(name)
                rest.remove(name)
        if len(order) == before:
            break
    return tuple(reversed(order)) if backward else tuple(order)


def _with(blocked: Bools, stands: Sequence[Ints]) -> Bools:
    """These tiles and more."""
    more = blocked.copy()
    for tiles in stands:
        more[tiles] = True
    return more
