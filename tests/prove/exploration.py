"""Explores all that may happen on a small table until nothing new comes, and judges every state."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

from mdms_cell.rights import right_of_way
from tests.prove.cells import NOTHING, SILENCE, Arrivals, Cell, Input, Memory, Rules
from tests.prove.parcels import Cells, Grid, Situation
from tests.prove.rules import Judge

#: Parcels by number and whether a cell may still crash.
World = tuple[tuple[Situation, ...], bool]
State = tuple[int, ...]  # number of the world, then of each cell's local state


class CounterexampleError(AssertionError):
    """A rule was broken; `trace` shows the states that lead there."""

    def __init__(self, rule: str, trace: list[str]) -> None:
        super().__init__("\n".join([rule, *trace]))
        self.rule = rule


class Found(NamedTuple):
    """The counts of an exploration to closure."""

    states: int
    transitions: int
    local_states: int
    runs: int


class Exploration:
    """All states of a table with parcels of these lengths, begun at rest at their places."""

    def __init__(
        self,
        grid: Grid,
        starts: tuple[Cells, ...],
        *,
        rules: Rules,
        crash: bool = True,
        module: Any = right_of_way,
        most_states: int = 10_000_000,
    ) -> None:
        spans = max(len(place) for place in starts) > 1
        reaction_beats = rules.hops * (rules.late + rules.hold) if spans else 0
        self.grid = grid = replace(grid, reaction_beats=reaction_beats)
        self.rules = rules
        self._most_states = most_states
        self._links = grid.neighbours
        self._judge = Judge(self._links, rules.hops * (rules.late + rules.hold), reaction_beats)
        self._places = range(len(self._links))
        self.cells = self._cells(module)
        self._said: list[dict[int, tuple[Arrivals, ...]]] = [{} for _ in self._places]
        self._worlds: list[World] = []
        self._inputs: list[tuple[Input, ...]] = []
        self._world_numbers: dict[World, int] = {}
        self._next_worlds: dict[tuple[int, tuple[tuple[bool, bool], ...]], list[int]] = {}
        self._heard_by = [
            [(there, direction ^ 4) for direction, there in sorted(links.items())]
            for links in self._links
        ]
        self._turns: list[tuple[int, int]] = []
        self._turned: dict[tuple[int, int, int], int] = {}
        world = self._number((tuple(Situation(place, place) for place in starts), crash))
        self.first: State = self.canonical(
            (
                world,
                *(
                    cell.settled(given)
                    for cell, given in zip(self.cells, self._inputs[world], strict=True)
                ),
            )
        )
        self.parents: dict[State, State | None] = {}
        self.transitions = 0

    def _cells(self, module: Any) -> list[Cell]:
        return [Cell(module, self.rules, links) for links in self._links]

    def world(self, state: State) -> World:
        """Where the parcels are in a state."""
        return self._worlds[state[0]]

    def memory(self, state: State, cell: int) -> Memory:
        """The memory of a cell in a state."""
        return self.cells[cell].locals[state[1 + cell]].memory

    def _number(self, world: World) -> int:
        number = self._world_numbers.setdefault(world, len(self._worlds))
        if number == len(self._worlds):
            self._worlds.append(world)
            self._inputs.append(tuple(self._input(world, cell) for cell in self._places))
        return number

    def _turn(self, world: int) -> tuple[int, int]:
        """By which symmetry a world becomes the one that stands for all its images, and which."""
        while len(self._turns) <= world:
            parcels, crash = self._worlds[len(self._turns)]
            images = [
                (self._number((tuple(each.turned(cells) for each in parcels), crash)), turn)
                for turn, (cells, _) in enumerate(self.grid.symmetries)
            ]
            self._turns.append(min(images))
        return self._turns[world]

    def canonical(self, state: State) -> State:
        """The state that stands for all that are its images by a symmetry of the table."""
        world, turn = self._turn(state[0])
        if not turn:
            return state
        images, directions = self.grid.symmetries[turn]
        after = [0] * len(state)
        after[0] = world
        for place in self._places:
            key = (turn, place, state[1 + place])
            number = self._turned.get(key)
            if number is None:
                number = self._turned[key] = self.cells[place].turned(
                    state[1 + place], directions, self.cells[images[place]]
                )
            after[1 + images[place]] = number
        return tuple(after)

    def _input(self, world: World, cell: int) -> Input:
        for identity, parcel in enumerate(world[0], 1):
            if cell in parcel.covers:
                wants, covers = (
                    sum(
                        1 << direction
                        for direction, there in self._links[cell].items()
                        if there in cells
                    )
                    for cells in (parcel.needs, parcel.covers)
                )
                return Input(identity, wants, covers)
        return NOTHING

    def _inbox(self, state: State, cell: int) -> tuple[Arrivals, ...]:
        return tuple(
            self._arrivals(there, state[1 + there])[direction]
            for there, direction in self._heard_by[cell]
        )

    def _arrivals(self, cell: int, number: int) -> tuple[Arrivals, ...]:
        """The possible arrivals of a cell's estimates, at its neighbours by direction.

        An estimate replaces what its sender said before, so of several the last one counts.
        """
        found = self._said[cell].get(number)
        if found is None:
            local = self.cells[cell].locals[number]
            found = self._said[cell][number] = tuple(
                tuple(
                    dict.fromkeys(
                        (identity, state, wants >> direction & 1, hold, covers >> direction & 1)
                        for identity, state, wants, hold, covers in (
                            *(local.estimate, *local.sent),
                            SILENCE,
                        )
                    )
                )
                for direction in range(8)
            )
        return found

    def _may_drive(self, state: State, identity: int) -> bool:
        """Whether any wheel under a parcel may turn."""
        return any(
            self.memory(state, cell).drive
            for cell in self.world(state)[0][identity - 1].covers
            if self.memory(state, cell).identity == identity
        )

    def _is_noticed(self, state: State, identity: int) -> bool:
        """Whether no cell that lives takes a parcel that lies over it for one to come."""
        found = (self.memory(state, cell) for cell in self.world(state)[0][identity - 1].covers)
        return not any(
            memory.unsure or (memory.identity == identity and memory.state == right_of_way.PROMISED)
            for memory in found
        )

    def _worlds_after(self, state: State) -> list[int]:
        """The possible changes of parcels within a beat; first no change."""
        parcels, crash = self.world(state)
        driven = tuple(
            (self._may_drive(state, identity), self._is_noticed(state, identity))
            for identity in range(1, len(parcels) + 1)
        )
        key = (state[0], driven)
        found = self._next_worlds.get(key)
        if found is None:
            moves = [
                self.grid.next_of(parcel, *seen)
                for parcel, seen in zip(parcels, driven, strict=True)
            ]
            found = [self._number((choice, crash)) for choice in product(*moves)]
            self._next_worlds[key] = found
        return found

    def may_all_drive(self, state: State, identity: int) -> bool:
        """Whether every wheel under a parcel may turn."""
        return all(
            self.memory(state, cell).drive and self.memory(state, cell).identity == identity
            for cell in self.world(state)[0][identity - 1].covers
        )

    def is_down(self, state: State) -> bool:
        """Whether a cell is silent for ever: then nothing is asked of the parcels."""
        return any(number == cell.down for cell, number in zip(self.cells, state[1:], strict=True))

    def prompt_successors(self, state: State) -> Iterator[tuple[State, tuple[Situation, ...]]]:
        """The states a beat later if every estimate arrives in its beat and no cell falls.

        With where the parcels are before the table is turned into the state that stands for it.
        """
        inboxes = [self._inbox(state, cell) for cell in self._places]
        for world in self._worlds_after(state):
            numbers = (
                cell.steps(number, inbox, given)[0]
                for cell, number, inbox, given in zip(
                    self.cells, state[1:], inboxes, self._inputs[world], strict=True
                )
            )
            yield self.canonical((world, *numbers)), self._worlds[world][0]

    def successors(self, state: State) -> Iterator[State]:
        """The states a beat later."""
        inboxes = [self._inbox(state, cell) for cell in self._places]
        for world in self._worlds_after(state):
            options = [
                cell.steps(number, inbox, given)
                for cell, number, inbox, given in zip(
                    self.cells, state[1:], inboxes, self._inputs[world], strict=True
                )
            ]
            for choice in self._choices(options):
                yield (world, *choice)
            yield from self._crashes(world, state, options)

    def _choices(self, options: list[tuple[int, ...]]) -> Iterator[tuple[int, ...]]:
        if self.rules.disturbed is None:
            yield from product(*options)
            return
        prompt = tuple(option[0] for option in options)
        yield prompt
        for place, option in enumerate(options):
            for number in option[1:]:
                yield (*prompt[:place], number, *prompt[place + 1 :])

    def _crashes(self, world: int, state: State, options: list[tuple[int, ...]]) -> Iterator[State]:
        """A cell falls silent or restarts, once; a silent cell restarts at any moment."""
        parcels, crash = self._worlds[world]
        after = self._number((parcels, False))
        for place, cell in enumerate(self.cells):
            number = state[1 + place]
            if crash or cell.locals[number].memory.down:
                fallen = cell.crashed(number, self._inputs[world][place])
                for choice in self._choices([*options[:place], fallen, *options[place + 1 :]]):
                    yield (after, *choice)

    def run(self) -> Found:
        """Explore to closure; raises CounterexampleError."""
        self.parents = {self.first: None}
        front = [self.first]
        while front:
            found: list[State] = []
            for state in front:
                for after in map(self.canonical, self.successors(state)):
                    self.transitions += 1
                    if after not in self.parents:
                        self.parents[after] = state
                        self._hold_against_the_rules(after)
                        found.append(after)
                if len(self.parents) > self._most_states:
                    raise MemoryError(f"more than {self._most_states} states")
            front = found
        return Found(
            states=len(self.parents),
            transitions=self.transitions,
            local_states=max(len(cell.locals) for cell in self.cells),
            runs=sum(cell.runs for cell in self.cells),
        )

    def _hold_against_the_rules(self, state: State) -> None:
        memories = [self.memory(state, cell) for cell in self._places]
        rule = self._judge.broken_rule(self.world(state)[0], memories)
        if rule:
            raise self._broken(rule, state)

    def _broken(self, rule: str, state: State) -> CounterexampleError:
        trace: list[str] = []
        at: State | None = state
        while at is not None:
            trace.append(self.told(at))
            at = self.parents.get(at)
        return CounterexampleError(rule, trace[::-1])

    def told(self, state: State) -> str:
        """A state in words."""
        parcels, crash, *more = self.world(state)
        lines = [
            " ".join(f"{sorted(parcel.covers)}>{sorted(parcel.needs)}" for parcel in parcels)
            + (" may crash" if crash else "")
            + "".join(f" {each}" for each in more)
        ]
        for cell in self._places:
            local = self.cells[cell].locals[state[1 + cell]]
            lines.append(f"   {cell}: {tuple(local.memory)[1:]} {local.sent}")
        return "\n".join(lines)
