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
_TRIES = 24
#: At which ends of an order the next parcel is tried, by turns: whether at its end.
_ENDS = ((True, False), (False, True), (True,), (True, False), (False, True), (False,))


def order_of(errands: Mapping[str, Errand], closed: Bools, free: Free) -> tuple[str, ...] | None:
    """An order in which the parcels with goals could go one after another; None: none was found.

    Orders are built from both ends, from the last to the first, and from the first to the last,
    each time of the parcels in another sequence.
    """
    moving = [name for name, errand in errands.items() if errand.task.goal is not None]
    standing = [errand.stand for errand in errands.values() if errand.task.goal is None]
    closed = _with(closed, standing)
    random = Random("orders")
    for number in range(_TRIES):
        order = _built(errands, moving, closed, free, _ENDS[number % len(_ENDS)])
        if order is not None:
            return order
        moving = random.sample(moving, len(moving))
    return None


def _built(
    errands: Mapping[str, Errand],
    moving: Sequence[str],
    closed: Bools,
    free: Free,
    ends: tuple[bool, ...],
) -> tuple[str, ...] | None:
    """An order that comes of taking whoever can be the last of the rest, or the first of it."""
    first: list[str] = []
    last: list[str] = []
    rest = list(moving)

    def goes(name: str, before: Sequence[str], after: Sequence[str]) -> bool:
        stands = [errands[other].goal_stand for other in (*first, *before)]
        stands += [errands[other].stand for other in (*after, *last)]
        return free(errands[name], _with(closed, stands))

    while rest:
        taken = len(first) + len(last)
        for name in tuple(rest):
            others = [other for other in rest if other != name]
            for at_end in ends:
                if goes(name, others, ()) if at_end else goes(name, (), others):
                    (last if at_end else first).append(name)
                    rest.remove(name)
                    break
        if len(first) + len(last) == taken:
            return None
    return (*first, *reversed(last))


def _with(blocked: Bools, stands: Sequence[Ints]) -> Bools:
    """These tiles and more."""
    more = blocked.copy()
    for tiles in stands:
        more[tiles] = True
    return more
