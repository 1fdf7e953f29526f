"""Whether a layout is well-formed, so that there is a plan for it whatever happens.

It is when there is an order in which each parcel has a way past the tiles under the goals of those
before it and the starts of those after it: planned in this order each finds a route, for at worst
it waits until those before it have come to their goals. It is so in any order when each has a way
past the starts and goals of all others at once; then nobody who waits at its start or stays at its
goal keeps another from going, and goals may be given one by one.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from random import Random

from mdms_host.routes.blocked import Blocked, Blocker, blockers
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


def ill_formed(errands: Mapping[str, Errand], closed: Bools, free: Free) -> tuple[Blocked, ...]:
    """Each parcel that has no way past all others' starts and goals, and which are in its way.

    `free` is whether an errand has a way past these tiles.
    """
    found = []
    for name, errand in errands.items():
        if errand.task.goal is None:
            continue
        places = [each for other, its in errands.items() if other != name for each in ends(its)]
        blocked = _with(closed, [tiles for _, tiles in places])
        if not free(errand, blocked):
            by = blockers(places, closed, partial(free, errand))
            found.append(Blocked(name, errand.task.start, errand.task.goal, *by))
    return tuple(found)


def ends(errand: Errand) -> Sequence[tuple[Blocker, Ints]]:
    """Where a parcel stands at its start, and at its goal if it stays there, and on which tiles."""
    task = errand.task
    start = Blocker(task.parcel, "start", task.start), errand.stand
    if task.goal is None or task.leaves:
        return (start,)
    return start, (Blocker(task.parcel, "goal", task.goal), errand.goal_stand)


def _with(blocked: Bools, stands: Sequence[Ints]) -> Bools:
    """These tiles and more."""
    more = blocked.copy()
    for tiles in stands:
        more[tiles] = True
    return more
