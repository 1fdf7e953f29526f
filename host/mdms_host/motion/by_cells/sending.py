"""Frames to the cells of one parcel: its program, until they acknowledge it, or its end."""

from collections.abc import Callable, Iterator
from math import inf

from mdms_host.estimation.tracker import Parcel
from mdms_host.motion.by_cells.notices import Lasting, cells_text
from mdms_host.motion.by_cells.pages import flags_of, parcel_page, place_page
from mdms_host.motion.by_cells.reports import Reports
from mdms_host.motion.by_cells.way import Way
from mdms_host.motion.goal import Limits
from mdms_model.arrays import Floats
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours.messages import End, Page

#: Pages are repeated so often [s] until the cells have acknowledged them.
REPEAT_S = 0.05
#: And the legs that follow a goal one by one, so far apart [s].
LEG_S = 0.02
#: Once most have, for so long for the sake of the rest; they are handed on by the others.
_REST_S = 0.5
#: Cells that lack something of a program get it from their neighbours within this, else from here
#: [s].
_LACKING_S = 0.2
#: No cell has the parcel any more when none has reported its identity for so long [s].
_GONE_S = 0.3
#: A parcel's first program; each change of its goal counts on, round and round.
_FIRST = 1
#: The page that ends a program is sent so often.
ENDS = 3


class Sending:
    """The program of one `parcel`, under the identity by which cells have the parcel.

    `way` is the way that they get or have, None where the parcel is to stay. `done` is whether they
    have all of it, but for single cells that go on reporting that they lack it: those get it
    repeated. Reports to a person are passed to `note`.
    """

    def __init__(
        self,
        parcel: Parcel,
        identity: int,
        reports: Reports,
        note: Callable[[str], None],
        *,
        limits: Limits,
        go_on: bool,
        planned: bool,
    ) -> None:
        self.identity = identity
        self.way: Way | None = None
        self.parcel = parcel
        self._reports = reports
        self._note = note
        self._limits = limits
        self._go_on = go_on
        self._planned = planned
        self._wanted: Way | None = None
        self._sequence = _FIRST
        self._ends = 0
        self.begin_again()

    def begin_again(self) -> None:
        """Send everything anew."""
        self._unanswered = Lasting()
        self._begin(-inf)

    def _begin(self, since_s: float) -> None:
        self.done = False
        self._since_s = since_s
        self._due_s = self._leg_due_s = -inf
        self._leg = 0
        self._mostly_s: float | None = None
        self._gone_s: float | None = None
        self._lacked_s: float | None = None

    @property
    def latest(self) -> Way | None:
        """The way that cells have, get, or are to get next."""
        return self._wanted or self.way

    @property
    def is_latest_there(self) -> bool:
        """Whether the cells have that."""
        return self.done and self._wanted is None

    @property
    def end_page(self) -> Page:
        """The page that ends the program."""
        return End(self.identity, self._sequence)

    def want(self, way: Way | None) -> None:
        """Have the cells get another way, once they have the one before: they tell three apart.

        None withdraws the last wanted way.
        """
        self._wanted = way

    def end(self) -> None:
        """End the program, and have the cells bring the parcel to rest; then its data go alone."""
        self.way = self._wanted = None
        self.give_anew()

    def give_anew(self) -> None:
        """Take the parcel from the cells that have it, and give it where it lies by then."""
        self._ends = ENDS

    def hand_on(self, parcel: Parcel) -> None:
        """Send for another parcel from now on; cells lose their data of the one before."""
        self.parcel = parcel
        self.end()
        self.begin_again()

    def overtaken(self) -> bool:
        """Whether cells that missed the host have gone on to the next leg; then so has the way."""
        way = self.way
        if way is None or not way.legs or not self.done:
            return False
        under = self._reports.under(self.identity).values()
        following = self._following
        if 2 * sum(each.sequence == following for each in under) <= len(under):
            return False
        self.way, self._sequence = way.rest(), following
        return True

    def pages(self, pose: Floats | None, now_s: float) -> Iterator[Page]:
        """The pages to send now; once a cycle. Without a pose [table frame] no program is sent."""
        self._change_way(now_s)
        if self._ends:
            yield self._last_page()
        elif pose is not None:
            self._check_acknowledged(pose, now_s)
            if not self.done or self._is_lacked(now_s):
                yield from self._program(pose, now_s)

    @property
    def _following(self) -> int:
        """The sequence number of the program that follows."""
        return int(self._sequence % wire.SEQUENCE_MAX + 1)

    def _change_way(self, now_s: float) -> None:
        """Begin to send the way that is wanted, if the cells are ready for it."""
        if self._wanted is None or not (self.done or now_s >= self._since_s + _REST_S):
            return
        self.way, self._wanted = self._wanted.after(self.way), None
        self._sequence = self._following
        self._begin(now_s)

    def _last_page(self) -> Page:
        """The page that ends the program, some times over; after it the parcel's data go."""
        self._ends -= 1
        if not self._ends:
            self._begin(-inf)
            self._reports.drop(self.identity)
        return self.end_page

    def _program(self, pose: Floats, now_s: float) -> Iterator[Page]:
        way, sequence = self.way, self._sequence
        if now_s < self._due_s:
            if way is not None and way.legs and now_s >= self._leg_due_s:
                self._leg_due_s = now_s + LEG_S
                self._leg = self._leg % way.legs + 1
                yield way.page(self.identity, sequence, self._leg)
            return
        self._due_s = now_s + REPEAT_S
        goal = None if way is None else way.goal
        flags = flags_of(goal, go_on=self._go_on, planned=self._planned)
        yield parcel_page(self.identity, sequence, self.parcel, self._limits, flags)
        yield place_page(self.identity, sequence, pose)
        if way is not None:
            yield way.page(self.identity, sequence)

    # Acknowledgements

    def _check_acknowledged(self, pose: Floats, now_s: float) -> None:
        """Send no more when all cells of the parcel have its program; again when none has it."""
        if self.done:
            self._check_gone(now_s)
            return
        having = self._cells_having()
        cells = self._reports.expected(self.parcel.bottom, pose)
        lacking, mostly = cells - having, 2 * len(having & cells) > len(cells)
        if not mostly:
            self._mostly_s = None
        elif self._mostly_s is None:
            self._mostly_s = now_s
        if self._mostly_s is not None:
            self.done = not lacking or now_s - self._mostly_s >= _REST_S
        unanswered = self._unanswered.step(bool(cells) and not mostly, now_s)
        if unanswered or (self.done and lacking):
            self._note(f"{cells_text(lacking)} under {self.parcel.name}: no answer to its program")

    def _is_lacked(self, now_s: float) -> bool:
        """Whether a cell at the parcel has reported for long that it lacks this program."""
        at_it = self._reports.of(self.identity)
        if self.way is None or at_it.keys() <= self._cells_having():
            self._lacked_s = None
            return False
        self._lacked_s = now_s if self._lacked_s is None else self._lacked_s
        return now_s - self._lacked_s >= _LACKING_S

    def _check_gone(self, now_s: float) -> None:
        if self._reports.of(self.identity):
            self._gone_s = None
            return
        self._gone_s = now_s if self._gone_s is None else self._gone_s
        if now_s - self._gone_s >= _GONE_S:
            self._note(f"no cell has {self.parcel.name} any more: its program is sent again")
            self._begin(-inf)

    def _cells_having(self) -> set[int]:
        """The cells that have acknowledged the program by their estimates."""
        sequence = 0 if self.way is None else self._sequence
        return {
            cell
            for cell, estimate in self._reports.of(self.identity).items()
            if estimate.sequence == sequence and not (sequence and estimate.flags & wire.LACKING)
        }
