"""Whether every parcel with a free way gets on, once estimates arrive.

Among all states that an exploration has found, with any losses on the way there, every estimate now
arrives in its beat and no cell falls. Parcels still choose freely. A parcel that waits is stuck if
there is a cycle in which it never may drive and nobody ever stands where it wants to go. Fair is a
cycle in which the others do not stop for ever while they might go on, to a cell that it waits for.
"""

from collections.abc import Iterable

from tests.prove.exploration import CounterexampleError, Exploration, State


class Progress:
    """The cycles of an explored table in which one parcel waits."""

    def __init__(self, exploration: Exploration, identity: int) -> None:
        self._table = exploration
        self._identity = identity
        self._successors: dict[State, list[State]] = {}

    def judge(self, states: Iterable[State]) -> int:
        """Return in how many states the parcel waits; raises CounterexampleError if it is stuck."""
        identity = self._identity
        waiting = {state for state in states if self._waits(state)}
        self._successors = {
            state: [
                after
                for after, parcels in self._table.prompt_successors(state)
                if parcels[identity - 1] == self._table.world(state)[0][identity - 1]
                and self._waits(after)
            ]
            for state in waiting
        }
        for component in self._components():
            if self._is_cycle(component) and not self._is_unfair(component):
                trace = [self._table.told(state) for state in component[:12]]
                raise CounterexampleError(f"parcel {self._identity} is stuck", trace)
        return len(waiting)

    def _waits(self, state: State) -> bool:
        """Whether the parcel waits with its way free, and may not go."""
        parcels, _ = self._table.world(state)
        own = parcels[self._identity - 1]
        others = [each for number, each in enumerate(parcels, 1) if number != self._identity]
        return (
            own.waits
            and not any(own.needs & other.covers for other in others)
            and not self._table.may_all_drive(state, self._identity)
            and not self._table.is_down(state)
        )

    def _is_cycle(self, component: list[State]) -> bool:
        return len(component) > 1 or component[0] in self._successors[component[0]]

    def _is_unfair(self, component: list[State]) -> bool:
        """Whether another might go all the time to where the parcel waits for, and never does."""
        for number in range(1, len(self._table.world(component[0])[0]) + 1):
            if number == self._identity:
                continue
            situations = {self._table.world(state)[0][number - 1] for state in component}
            other = next(iter(situations))
            own = self._table.world(component[0])[0][self._identity - 1]
            if (
                len(situations) == 1
                and other.needs & own.needs
                and all(self._table.may_all_drive(state, number) for state in component)
            ):
                return True
        return False

    def _components(self) -> Iterable[list[State]]:
        """The strongly connected components, by Tarjan's algorithm without recursion."""
        index: dict[State, int] = {}
        lowest: dict[State, int] = {}
        stack: list[State] = []
        on_stack: set[State] = set()
        for root in self._successors:
            if root in index:
                continue
            work = [(root, iter(self._successors[root]))]
            index[root] = lowest[root] = len(index)
            stack.append(root)
            on_stack.add(root)
            while work:
                state, rest = work[-1]
                for after in rest:
                    if after not in index:
                        index[after] = lowest[after] = len(index)
                        stack.append(after)
                        on_stack.add(after)
                        work.append((after, iter(self._successors[after])))
                        break
                    if after in on_stack:
                        lowest[state] = min(lowest[state], index[after])
                else:
                    work.pop()
                    if work:
                        lowest[work[-1][0]] = min(lowest[work[-1][0]], lowest[state])
                    if lowest[state] == index[state]:
                        component = []
                        while True:
                            member = stack.pop()
                            on_stack.discard(member)
                            component.append(member)
                            if member == state:
                                break
                        yield component
