"""A lost cell that parcels cross: the host's rounds, and all that may happen to the cell.

The host declares the cell at any time, lost or not, and for any parcel: the cells around it have
the say. Pages and answers get lost. A round may end late, but then the next one begins anew. Once
the cell is silent, dead or cut off, it may come back with its memory from before. Then the host
restarts it, and revokes the declaration.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

from mdms_cell.rights import right_of_way
from mdms_cell.rights.right_of_way import PROMISED, UNDER
from tests.prove.cells import DOWN, Arrivals, Cell, Input, Memory, Message, Rules
from tests.prove.exploration import Exploration, State
from tests.prove.parcels import Cells, Grid, Situation
from tests.prove.rules import Judge, Links

#: The number of the host's round, as cells are restored; theirs are lower.
_NUMBER = 1000
#: A page of a round so many after the last: again, the next one, or a new beginning.
AGAIN, NEXT, ANEW = 0, 1, 2
#: In place of that: the declaration is revoked.
REVOKED = 3
#: No agreement counts any more.
_NEVER = 255


class Times(NamedTuple):
    """For how many beats an agreement counts, how many of them are for a round, and after how many
    a silent cell is lost.
    """

    lease_beats: int = 3
    round_beats: int = 1
    lost_beats: int = 2


@dataclass(frozen=True)
class GridAround(Grid):
    """A table on which no parcel lies on the lost cell alone: parcels are larger than a square."""

    lost: int = 0

    def next_of(self, now: Situation, may_drive: bool, noticed: bool = True) -> list[Situation]:
        """The same, but for places on the lost cell alone."""
        found = super().next_of(now, may_drive, noticed)
        return [each for each in found if each.covers != {self.lost}]


class Beside(Cell):
    """A cell beside the one that is lost, which lies in a direction."""

    def __init__(
        self, module: Any, rules: Rules, links: Iterable[int], direction: int, times: Times
    ) -> None:
        super().__init__(module, rules, links)
        self._direction = direction
        self._times = times
        self._decider.lost.set_lease(*times)

    def _of_sure(self, place: int, arrivals: Arrivals) -> Arrivals:
        """The same; whether the lost cell lives matters here."""
        lives_matters = self._directions[place] == self._direction
        return arrivals if lives_matters else super()._of_sure(place, arrivals)

    def _follow(self, number: int, inbox: tuple[Arrivals, ...], given: Input) -> Iterable[int]:
        yield from super()._follow(number, inbox, given)
        if given.page[0] and self._rules.disturbed != 0:
            identity, kind = given.page
            missed = (-identity, kind)
            prompt = tuple(arrivals[:1] for arrivals in inbox)
            yield from super()._follow(number, prompt, given._replace(page=missed))

    def _beat(self, memory: Memory, heard: set[int], given: Input, occupied: int) -> Memory:
        silent = 0 if self._direction in heard else memory.lost[0] + 1
        silent = min(silent, self._times.lost_beats)
        agrees, bump = self._take_page(given.page, silent)
        self._decider.on_beat(given.over, given.wants, occupied)
        return self._beside(given, silent, agrees, bump)

    def _take_page(self, page: tuple[int, int], silent: int) -> tuple[bool, int]:
        """Whether the cell agrees to what may have come, and by how many its number falls back."""
        identity, kind = page
        if kind == REVOKED:
            if identity > 0:
                self._decider.readmit(self._direction)
            return False, 0
        if identity <= 0:
            return False, kind
        agrees = self._decider.do_without(self._direction, identity, _NUMBER + kind, silent)
        return agrees, kind

    def _beside(self, given: Input, silent: int, agrees: bool, bump: int) -> Memory:
        lost, at = self._decider.lost, self._direction
        behind = _NUMBER + bump - lost._numbers[at]
        agreed, kept, granted = (
            lost._agreed_beats[at],
            lost._kept_beats[at],
            lost._granted_beats[at],
        )
        if behind > NEXT or agreed >= self._times.lease_beats - self._times.round_beats:
            # Whatever the host sends now begins anew for this cell.
            behind = agreed = _NEVER
        memory = super()._snapshot(given)
        identity = lost._identities[at] if kept or granted or agreed != _NEVER else 0
        own = (silent, lost.mask >> at & 1, identity, behind, agreed, granted, kept)
        return memory._replace(lost=own, agrees=agrees)

    def _snapshot(self, given: Input) -> Memory:
        """After a restart: nothing has been heard of the lost cell since, so it may be lost."""
        return self._beside(given, self._times.lost_beats, False, 0)

    def _restore(self, memory: Memory) -> None:
        super()._restore(memory)
        lost, at = self._decider.lost, self._direction
        if memory.lost:
            _, voted, identity, behind, agreed, granted, kept = memory.lost
            lost.mask = voted << at
            lost._identities[at] = identity
            lost._numbers[at] = 0 if behind == _NEVER else _NUMBER - behind
            lost._agreed_beats[at] = agreed
            lost._granted_beats[at], lost._kept_beats[at] = granted, kept


class Lost(Cell):
    """The cell that is lost: it may be cut off, and come back as it was."""

    def _follow(self, number: int, inbox: tuple[Arrivals, ...], given: Input) -> Iterable[int]:
        memory = self.locals[number].memory
        given = given._replace(page=(0, 0))
        if memory.cut_off == 1:
            # No SYNC comes, so nothing is decided; or it is in touch again, after a gap.
            yield number
            yield self._back(number)
            return
        yield from super()._follow(number, inbox, given)
        if memory.cut_off and given.over and memory.promised != given.over:
            # It knows nothing of what has come over its square meanwhile, by an edge.
            after = self._decide(memory, (), Input(0, 0, 0), False)
            yield self._number(self._after(self.locals[number], after))

    def _back(self, number: int) -> int:
        self._restore(self.locals[number].memory)
        self._decider.on_gap()
        memory = self._snapshot(Input(0, 0, 0))._replace(cut_off=2)
        return self._number(self.locals[number]._replace(memory=memory, sent=self._nothing))

    def _decide(
        self,
        memory: Memory,
        delivered: tuple[tuple[int, Message], ...],
        given: Input,
        occupied: int,
    ) -> Memory:
        found = super()._decide(memory, delivered, given, occupied)
        return found._replace(cut_off=memory.cut_off)

    def fallen(self, number: int) -> tuple[int, ...]:
        """Dead, or cut off."""
        local = self.locals[number]
        cut = local.memory._replace(cut_off=1, drive=0)
        return self._number(self._after(local, DOWN)), self._number(self._after(local, cut))

    def restarted(self, given: Input) -> int:
        """Brought up again by the host."""
        return self._number(self._after(self.locals[self.down], self._restarted(given)))


class Host(NamedTuple):
    """The parcel of the round, who has agreed (a mask), and the beats since it began.

    The round is over once `age` is beyond the beats for it. `revoking` is whether it has restarted
    the cell.
    """

    identity: int = 0
    agreed: int = 0
    age: int = 9
    revoking: bool = False


class JudgeOfLost(Judge):
    """Where all around a cell do without it, their word counts in place of its own."""

    def __init__(self, links: Links, after_lease_beats: int, reaction_beats: int, cell: int):
        super().__init__(links, after_lease_beats, reaction_beats)
        self._cell = cell
        self._around = tuple(links[cell].values())

    def _is_declared(self, cells: list[Memory]) -> bool:
        return all(cells[each].lost and cells[each].lost[1] for each in self._around)

    def _holders(self, cells: list[Memory], cell: int) -> set[int]:
        if cell != self._cell or not self._is_declared(cells):
            return super()._holders(cells, cell)
        own = cells[cell]
        without = [*cells]
        without[cell] = own._replace(state=0, identity=0)
        return super()._holders(without, cell)

    def _turning_too_long(
        self, parcels: tuple[Situation, ...], cells: list[Memory], cell: int
    ) -> str | None:
        hidden = [*cells]
        hidden[self._cell] = hidden[self._cell]._replace(down=True)
        if not self._is_declared(cells):
            if cells[self._cell].cut_off != 1:
                return super()._turning_too_long(parcels, cells, cell)
            return super()._turning_too_long(parcels, hidden, cell)
        turning = cells[cell]
        for there in self._around:
            other = cells[there]
            wants = other.identity == turning.identity and other.state == UNDER
            if not wants or not any(
                at == self._cell and other.wants >> direction & 1
                for direction, at in self._links[there].items()
            ):
                continue
            if parcels[turning.identity - 1].waits and there != cell:
                continue
            for each in self._around:
                left = cells[each].bound
                if cells[each].promised != turning.identity or turning.drive > left:
                    return f"wheels of {cell} turn over the lost cell, and {each} is not kept"
        return super()._turning_too_long(parcels, hidden, cell)


class LostExploration(Exploration):
    """All states of a table that loses one cell; a world has the state of the host, too."""

    def __init__(
        self,
        grid: GridAround,
        starts: tuple[Cells, ...],
        *,
        rules: Rules,
        times: Times,
        crossing: bool = False,
        module: Any = right_of_way,
        most_states: int = 10_000_000,
    ) -> None:
        self._lost = lost = grid.lost
        self._times = times
        self._pages: dict[int, tuple[int, int]] = {}
        super().__init__(
            grid, starts, rules=rules, crash=True, module=module, most_states=most_states
        )
        links = self._links
        self._around = tuple(sorted(links[lost].values()))
        self._all = sum(1 << each for each in self._around)
        settling = self._judge
        self._judge = JudgeOfLost(
            links, settling._after_lease_beats, settling._reaction_beats, lost
        )
        if crossing:
            self.first = self._crossing(starts)

    def _crossing(self, starts: tuple[Cells, ...]) -> State:
        """The first parcel has come over the cell, which is cut off and knows nothing of it."""
        first = Situation(starts[0], frozenset((self._lost,)), on_its_way=True)
        others = (Situation(place, place) for place in starts[1:])
        world = self._number(((first, *others), False, Host(), (0, 0)))
        declared = (self._times.lost_beats, 1, 0, _NEVER, _NEVER, 0, 0)
        numbers = []
        for place, cell in enumerate(self.cells):
            if place == self._lost:
                local = cell.locals[cell.settled(Input(0, 0, 0))]
                memory = local.memory._replace(cut_off=1, drive=0)
            else:
                local = cell.locals[cell.settled(self._inputs[world][place])]
                memory = local.memory
                if place in self._around:
                    memory = memory._replace(lost=declared)
            numbers.append(cell._number(local._replace(memory=memory)))
        return world, *numbers

    def _cells(self, module: Any) -> list[Cell]:
        found: list[Cell] = []
        for place, links in enumerate(self._links):
            direction = next((way for way, at in links.items() if at == self._lost), None)
            if place == self._lost:
                found.append(Lost(module, self.rules, links))
            elif direction is None:
                found.append(Cell(module, self.rules, links))
            else:
                found.append(Beside(module, self.rules, links, direction, self._times))
        return found

    def canonical(self, state: State) -> State:
        """Without the page, which has come by now; no symmetry keeps the lost cell in its place."""
        parcels, crash, *more = self._worlds[state[0]]
        host = more[0] if more else Host()
        return (self._number((parcels, crash, host, (0, 0))), *state[1:])

    def _input(self, world: Any, cell: int) -> Input:
        page = world[3] if len(world) > 3 and cell != self._lost else (0, 0)
        return super()._input(world, cell)._replace(page=page)

    def _hosts_after(self, state: State) -> Iterator[tuple[Host, tuple[int, int]]]:
        """What the host may do within a beat, with its page."""
        world = self.world(state)
        host: Host = world[2] if len(world) > 2 else Host()
        if host.revoking:
            yield host, (0, 0)
            yield host, (1, REVOKED)
            return
        agreed = host.agreed | sum(
            1 << each for each in self._around if self.memory(state, each).agrees
        )
        age = min(host.age + 1, self._times.round_beats + 1)
        within = host.identity and age <= self._times.round_beats
        yield Host(host.identity, agreed, age) if within else Host(), (0, 0)
        if within and agreed == self._all:
            yield Host(host.identity, 0, 0), (host.identity, NEXT)
        elif within:
            yield Host(host.identity, agreed, age), (host.identity, AGAIN)
        else:
            for identity in range(1, len(world[0]) + 1):
                yield Host(identity, 0, 0), (identity, ANEW)

    def _worlds_after(self, state: State) -> list[int]:
        parcels, crash, *_ = self.world(state)
        moves = [
            self.grid.next_of(
                parcel, self._may_drive(state, identity), self._is_noticed(state, identity)
            )
            for identity, parcel in enumerate(parcels, 1)
        ]
        return [
            self._number((choice, crash, host, page))
            for choice in product(*moves)
            for host, page in self._hosts_after(state)
        ]

    def _may_drive(self, state: State, identity: int) -> bool:
        cells = self.world(state)[0][identity - 1].covers
        return any(
            self.memory(state, cell).drive
            for cell in cells
            if self.memory(state, cell).identity == identity
        )

    def _is_noticed(self, state: State, identity: int) -> bool:
        """The same; nothing is asked of a cell that is out of touch, or was."""
        covers = self.world(state)[0][identity - 1].covers
        found = [
            self.memory(state, cell)
            for cell in covers
            if cell != self._lost or not self.memory(state, cell).cut_off
        ]
        return not any(
            memory.unsure or (memory.identity == identity and memory.state == PROMISED)
            for memory in found
        )

    def _crashes(self, world: int, state: State, options: list[tuple[int, ...]]) -> Iterator[State]:
        """The cell is lost, once; then the host restarts it at any moment."""
        parcels, crash, host, page = self._worlds[world]
        place, cell = self._lost, self.cells[self._lost]
        assert isinstance(cell, Lost)
        memory = cell.locals[state[1 + place]].memory
        if crash:
            after = self._number((parcels, False, host, page))
            fallen = cell.fallen(state[1 + place])
        elif (memory.down or memory.cut_off) and not host.revoking:
            after = self._number((parcels, False, Host(revoking=True), (0, 0)))
            fallen = (cell.restarted(self._inputs[world][place]._replace(page=(0, 0))),)
        else:
            return
        for choice in self._choices([*options[:place], fallen, *options[place + 1 :]]):
            yield (after, *choice)
