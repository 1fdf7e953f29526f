"""The cells of a table, each decided by the very module, with the messages on their way to it.

The step of a cell within a beat is a function of its own memory, of the estimates that reach it and
of the parcel on it, so each such step is run once and kept.
"""

from array import array
from collections.abc import Iterable
from itertools import product
from typing import Any, NamedTuple

from mdms_cell.rights import right_of_way
from mdms_protocol.neighbours import frames as wire

#: Silence, and the message of a cell that lives and has nothing to say: its speeds.
SILENCE = (0, 0, 0, 0, 0)
ALIVE = (0, 0, 0, right_of_way.CLEAR, 0)
#: Identity, state, whether the receiver is wanted, hold, whether the parcel lies over the receiver.
Message = tuple[int, int, int, int, int]
#: The deliveries of a link within a beat, each alone: this beat's estimate first, silence at last.
Arrivals = tuple[Message, ...]


class Rules(NamedTuple):
    """The times that the cells are set up with [beats].

    Where a parcel is not `placed`, a restarted cell hears which parcel lies over a neighbour, and
    not whether it reaches the cell's own square. Things are `set_down` on cells at any time, and
    `upon` cells that a parcel has come over and that do not know it yet.
    """

    lease: int = 3
    late: int = 1
    hold: int = 1
    hops: int = 1
    patience: int = 8
    disturbed: int | None = None  # links on which estimates may be lost or late within a beat
    placed: bool = True
    set_down: bool = False
    upon: bool = False


class Delivery:
    """Estimates as a cell takes them: a row a direction, and whether that one has come."""

    def __init__(self) -> None:
        self._rows = array("h", [0] * (right_of_way.DIRECTIONS * wire.ESTIMATE_FIELDS))
        self._fresh = bytearray(right_of_way.DIRECTIONS)

    def put(self, direction: int, message: Message) -> None:
        """An estimate has come from this direction."""
        identity, state, wants_me, hold = message[:4]
        at = direction * wire.ESTIMATE_FIELDS
        self._rows[at + wire.IDENTITY] = identity
        self._rows[at + wire.STATE] = state
        self._rows[at + wire.WANTS] = bool(wants_me) << (direction ^ 4)
        self._rows[at + wire.HOLD] = hold
        self._fresh[direction] = 1

    def hand_over(self, cell: Any) -> None:
        """Pass on the arrived estimates, once."""
        cell.on_estimates(self._rows, self._fresh)
        self._fresh[:] = bytes(right_of_way.DIRECTIONS)


class Memory(NamedTuple):
    """The data that decisions of a cell depend on, its message, and the permission of its wheels.

    NEAR is kept as NONE, for no decision depends on it. The parcels around are kept where the cell
    is unsure.
    """

    down: bool
    identity: int
    state: int
    hold: int
    drive: int
    wants: int
    promised: int
    bound: int
    waiting: int
    said: tuple[tuple[int, int, int, int, int], ...]  # direction, identity, state, hold, left
    covers: int
    unsure: bool
    unheeded: int
    around: tuple[tuple[int, int, int], ...]  # direction, beats of silence, parcel reported here
    #: 1: cut off, and without SYNC; 2: in touch again, with the memory from before
    cut_off: int = 0
    lost: tuple[int, ...] = ()  # of a neighbour of the cell that is lost, see `tests.prove.lost`
    agrees: bool = False  # it has agreed within this beat


#: Identity, state, mask of neighbours wanted, hold, mask of neighbours that the parcel lies over.
Estimate = tuple[int, int, int, int, int]


class Local(NamedTuple):
    """A cell's memory, and the estimates that it sent before and that may still arrive."""

    memory: Memory
    sent: tuple[Estimate, ...]

    @property
    def estimate(self) -> Estimate:
        """The cell's next estimate; an estimate without right of way shows that the cell lives."""
        memory = self.memory
        if memory.down or memory.cut_off == 1:
            return SILENCE
        if memory.state < right_of_way.PROMISED:
            return ALIVE
        return memory.identity, memory.state, memory.wants, memory.hold, memory.covers


class Input(NamedTuple):
    """The parcel on a cell, the neighbours that it needs, and those that it stands on, too."""

    over: int
    wants: int
    covers: int
    page: tuple[int, int] = (0, 0)  # of the host, see `tests.prove.lost`; of no parcel: none


NOTHING = Input(0, 0, 0)
DOWN = Memory(True, 0, 0, right_of_way.CLEAR, 0, 0, 0, 0, 0, (), 0, False, 0, ())


class Cell:
    """One cell of the table: numbers its local states, and returns the successors of each."""

    def __init__(self, module: Any, rules: Rules, directions: Iterable[int]) -> None:
        self._rules = rules
        self._directions = tuple(sorted(directions))
        self._neighbours = sum(1 << direction for direction in self._directions)
        self._module = module
        self._decider = module.RightOfWay(
            lease_beats=rules.lease,
            late_beats=rules.late,
            hold_beats=rules.hold,
            hops=rules.hops,
            patience_beats=rules.patience,
        )
        self._delivery = Delivery()
        self.locals: list[Local] = []
        self._numbers: dict[Local, int] = {}
        self._steps: dict[tuple[int, tuple[Arrivals, ...], Input], tuple[int, ...]] = {}
        self._decided: dict[Any, Memory] = {}
        self.runs = 0
        self._nothing = (SILENCE,) * rules.late
        self.down = self._number(Local(DOWN, self._nothing))

    def _number(self, local: Local) -> int:
        number = self._numbers.setdefault(local, len(self.locals))
        if number == len(self.locals):
            self.locals.append(local)
        return number

    def turned(self, number: int, directions: tuple[int, ...], image: "Cell") -> int:
        """The local state of another cell that is this one turned or mirrored."""
        memory, sent = self.locals[number]
        memory = memory._replace(
            wants=_turned_mask(memory.wants, directions),
            said=tuple(sorted((directions[said[0]], *said[1:]) for said in memory.said)),
            covers=_turned_mask(memory.covers, directions),
            around=tuple(sorted((directions[each[0]], *each[1:]) for each in memory.around)),
        )
        return image._number(
            Local(
                memory,
                tuple(
                    (
                        *(identity, state, _turned_mask(wants, directions), hold),
                        _turned_mask(covers, directions),
                    )
                    for identity, state, wants, hold, covers in sent
                ),
            )
        )

    def settled(self, given: Input) -> int:
        """The local state long after a restart, with this parcel standing on the cell."""
        restarted = self._restarted(given)._replace(unsure=False, unheeded=0, around=())
        local = Local(restarted, self._nothing)
        for _ in range(50):
            local = self._after(local, self._decide(local.memory, (), given, bool(given.over)))
        return self._number(local)

    def _after(self, local: Local, memory: Memory) -> Local:
        return Local(memory, (local.estimate, *local.sent)[: self._rules.late])

    def crashed(self, number: int, given: Input) -> tuple[int, ...]:
        """The local states in which a crash leaves the cell: silent, or up again at once."""
        local = self.locals[number]
        return tuple(
            self._number(self._after(local, memory)) for memory in (DOWN, self._restarted(given))
        )

    def _restarted(self, given: Input) -> Memory:
        self._decider.restart(self._neighbours)
        self._decider.on_beat(0, 0, bool(given.over))
        return self._snapshot(NOTHING)

    def steps(self, number: int, inbox: tuple[Arrivals, ...], given: Input) -> tuple[int, ...]:
        """The local states that may follow; first that in which every estimate arrives at once."""
        if not self.locals[number].memory.unsure:
            inbox = tuple(self._of_sure(place, arrivals) for place, arrivals in enumerate(inbox))
        key = (number, inbox, given)
        found = self._steps.get(key)
        if found is None:
            found = self._steps[key] = tuple(dict.fromkeys(self._follow(number, inbox, given)))
        return found

    def _of_sure(self, _place: int, arrivals: Arrivals) -> Arrivals:
        """What a cell that is sure takes in: not whether neighbours live, nor the parcel here."""
        return tuple(dict.fromkeys(map(_plain, arrivals)))

    def _follow(self, number: int, inbox: tuple[Arrivals, ...], given: Input) -> Iterable[int]:
        local = self.locals[number]
        if local.memory.down:
            yield self._number(self._after(local, DOWN))
            return
        lags = given.over and local.memory.promised != given.over
        for choice in self._choices(inbox):
            delivered = tuple(
                (direction, message)
                for direction, message in zip(self._directions, choice, strict=True)
                if message != SILENCE
            )
            memory = self._decide(local.memory, delivered, given, bool(given.over))
            yield self._number(self._after(local, memory))
            if self._rules.set_down and not given.over:
                memory = self._decide(local.memory, delivered, given, right_of_way.BY_ANOTHER)
                yield self._number(self._after(local, memory))
            if self._rules.upon and given.over and local.memory.state != right_of_way.UNDER:
                memory = self._decide(local.memory, delivered, NOTHING, right_of_way.BY_ANOTHER)
                yield self._number(self._after(local, memory))
            if lags:
                memory = self._decide(local.memory, delivered, NOTHING, True)
                yield self._number(self._after(local, memory))
            if lags and local.memory.unsure and given.covers:
                # An edge lies over the square, and over no sensor.
                memory = self._decide(local.memory, delivered, NOTHING, False)
                yield self._number(self._after(local, memory))

    def _choices(self, inbox: tuple[Arrivals, ...]) -> Iterable[tuple[Message, ...]]:
        """The estimates that may arrive from all neighbours; first all of this beat's, at once."""
        if self._rules.disturbed is None:
            yield from product(*inbox)
            return
        prompt = tuple(arrivals[0] for arrivals in inbox)
        yield prompt
        for place, arrivals in enumerate(inbox if self._rules.disturbed else ()):
            for message in arrivals[1:]:
                yield (*prompt[:place], message, *prompt[place + 1 :])

    def _decide(
        self,
        memory: Memory,
        delivered: tuple[tuple[int, Message], ...],
        given: Input,
        occupied: int,
    ) -> Memory:
        """Run the module for one beat."""
        key = (memory, delivered, given, occupied)
        found = self._decided.get(key)
        if found is None:
            self.runs += 1
            self._restore(memory)
            for direction, message in delivered:
                self._delivery.put(direction, message)
                if memory.unsure:
                    self._decider.hear(direction, self._reported(message))
            self._delivery.hand_over(self._decider)
            heard = {direction for direction, _ in delivered}
            found = self._decided[key] = self._beat(memory, heard, given, occupied)
        return found

    def _reported(self, message: Message) -> int:
        """The parcel that a neighbour reports over the cell, as `hear` takes it."""
        identity, state, _, _, over = message
        if state != right_of_way.UNDER:
            return 0
        if not self._rules.placed:
            return identity | right_of_way.UNPLACED
        return identity if over else 0

    def _beat(self, memory: Memory, heard: set[int], given: Input, occupied: int) -> Memory:
        """Let a beat pass after the estimates of some directions were handed over."""
        self._decider.on_beat(given.over, given.wants, occupied)
        return self._snapshot(given)

    def _restore(self, memory: Memory) -> None:
        decider = self._decider
        decider.restart(self._neighbours)
        decider.unsure = memory.unsure
        decider.unheeded_beats = memory.unheeded
        for direction, silent_beats, reported in memory.around:
            decider.silent_beats[direction] = silent_beats
            decider.reported[direction] = reported
        registers = decider.registers
        registers[right_of_way.IDENTITY] = memory.identity
        registers[right_of_way.STATE] = memory.state
        registers[right_of_way.HOLD] = memory.hold
        registers[right_of_way.PROMISED_TO] = memory.promised
        registers[right_of_way.BOUND] = memory.bound
        registers[right_of_way.WAITING] = memory.waiting
        for direction, identity, state, hold, left in memory.said:
            decider.said[right_of_way.IDENTITIES + direction] = identity
            decider.said[right_of_way.STATES + direction] = state
            decider.said[right_of_way.HOLDS + direction] = hold
            decider.said[right_of_way.LEFT + direction] = left

    def _snapshot(self, given: Input) -> Memory:
        decider = self._decider
        registers = decider.registers
        shown = decider.state >= right_of_way.PROMISED
        under = decider.state == right_of_way.UNDER
        # No neighbour is silent for so long that it is dead.
        most = self._rules.lease - self._rules.late
        return Memory(
            down=False,
            identity=decider.identity if shown else 0,
            state=decider.state if shown else right_of_way.NONE,
            hold=decider.hold,
            drive=decider.drive_beats,
            wants=given.wants if under else 0,
            promised=registers[right_of_way.PROMISED_TO],
            bound=registers[right_of_way.BOUND],
            waiting=registers[right_of_way.WAITING],
            said=tuple(
                (
                    direction,
                    decider.said[right_of_way.IDENTITIES + direction],
                    decider.said[right_of_way.STATES + direction],
                    decider.said[right_of_way.HOLDS + direction],
                    decider.said[right_of_way.LEFT + direction],
                )
                for direction in self._directions
                if decider.said[right_of_way.LEFT + direction]
            ),
            covers=given.covers if under else 0,
            unsure=decider.unsure,
            unheeded=decider.unheeded_beats if decider.unsure else 0,
            around=tuple(
                (direction, min(decider.silent_beats[direction], most), decider.reported[direction])
                for direction in self._directions
                if decider.unsure
            ),
        )


def _plain(message: Message) -> Message:
    """A message as a cell takes it when it knows the parcel over it."""
    return SILENCE if message == ALIVE else (*message[:4], 0)


def _turned_mask(mask: int, directions: tuple[int, ...]) -> int:
    return sum(1 << directions[direction] for direction in range(8) if mask >> direction & 1)
