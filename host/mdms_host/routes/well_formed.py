"""Whether a layout is well-formed, so that there is a plan for it whatever happens.

It is when there is an order in which each parcel has a way past the tiles under the goals of those
before it and the starts of those after it: planned in this order each finds a route, for at worst
it waits until those before it have come to their goals. It is so in any order when each has a way
past the starts and goals of all others at once; then nobody who waits at its start or stays at its
goal keeps another from going, and goals may be given one by one.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from mdms_host.routes.blocked import Blocked, Blocker, blockers
from mdms_host.routes.errand import Errand
from mdms_model.arrays import Bools, Ints

Free = Callable[[Errand, Bools], bool]


#: So many ways are looked for before the search for an order is given up, by parcel.
_TRIES = 12


def order_of(errands: Mapping[str, Errand], closed: Bools, free: Free) -> tuple[str, ...] | None:
    """An order in which the parcels with goals could go one after another; None: none was found.

    Depth first: whoever has a way goes, and where nobody has one the last to go is another.
    """
    moving = [name for name, errand in errands.items() if errand.task.goal is not None]
    standing = [errand.stand for errand in errands.values() if errand.task.goal is None]
    closed = _with(closed, standing)
    left = _TRIES * len(moving)

    def onward(done: tuple[str, ...]) -> tuple[str, ...] | None:
        nonlocal left
        waiting = [name for name in moving if name not in done]
        if not waiting:
            return done
        goals = _with(closed, [errands[name].goal_stand for name in done])
        for name in waiting:
            left -= 1
            if left < 0:
                return None
            others = [errands[other].stand for other in waiting if other != name]
            if free(errands[name], _with(goals, others)):
                order = onward((*done, name))
                if order is not None:
                    return order
        return None

    return onward(())


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
