"""The host's place on the buses of a table: a coordinator while a program runs, else nobody."""

from collections.abc import Callable, Iterable
from math import inf

from mdms_host.can_link.recent import Recent
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.other_host import OtherHost
from mdms_host.page.bus_watch import BusWatch
from mdms_host.page.cell_objects import ObjectReader
from mdms_host.page.commands import PageRefusedError
from mdms_protocol import indices
from mdms_protocol.codecs import cob, nmt, sdo
from mdms_protocol.codecs.frame import Frame

#: How often the place looks whether somebody has taken it [s].
IDLE_S = 0.01
#: A broadcast is not confirmed, so it is repeated.
_REPEATS = 3
#: A reader or writer of objects asks for the next within this [s].
_ASKS_S = 0.2
_CLAIM = sdo.read_request(indices.IDENTITY, 4)[:4]


def _is_request(frame: Frame) -> bool:
    """Whether somebody reads or writes an object.

    A cell that starts asks so for its own node id, with its serial number behind the question.
    """
    if frame.can_id & ~cob.NODE_MAX != cob.SDO_REQUEST_BASE:
        return False
    return frame.data[:4] != _CLAIM or not any(frame.data[4:])


class RunSlot:
    """A participant of the buses whose coordinator comes and goes, made anew for every start.

    `watch` is given every frame of the buses, received or sent, where nobody else does that.
    `on_cycle(late_s)` is called with how late each poll was. `recent` keeps these frames for a
    minute, if it is given.
    """

    def __init__(
        self,
        make: Callable[[], Coordinator],
        buses: int,
        watch: BusWatch | None = None,
        recent: Recent | None = None,
    ) -> None:
        self.on_cycle: Callable[[float], object] = lambda _late_s: None
        #: Why the machine of a line takes no run that is started by hand; empty if it does.
        self.refusal: Callable[[], str] = lambda: ""
        #: Whether the way to the cells is open.
        self.is_there: Callable[[], bool] = lambda: True
        self.coordinator: Coordinator | None = None
        self.reader: ObjectReader | None = None
        #: How often somebody has asked for an end.
        self.stops = 0
        self._make = make
        self._buses = buses
        self._watch = watch
        self._recent = recent
        self._other_host = OtherHost()
        self._asked_s = -inf
        self._looked_s = -IDLE_S
        self._all_off = 0

    @property
    def busy(self) -> bool:
        """Whether a program runs, or is on its way to its end."""
        return self.coordinator is not None and not self.coordinator.stopped

    @property
    def beside_other_host(self) -> bool:
        """Whether another host speaks on one of the buses."""
        return self._other_host.speaks(self._looked_s)

    @property
    def others_ask(self) -> bool:
        """Whether somebody else has read or written objects lately: a cell answers one only."""
        return self._looked_s - self._asked_s < _ASKS_S

    def start(self) -> None:
        """Begin the program by hand. Raises `PageRefusedError` like `begin`, and by `refusal`."""
        refusal = "" if self.busy else self.refusal()
        if refusal:
            raise PageRefusedError(refusal)
        self.begin()

    def begin(self) -> None:
        """Begin the program anew.

        Raises `PageRefusedError` while one runs, and while another host speaks: the two would stop
        each other, and cells be switched off that the other one moves parcels with. So it does
        while firmware comes into cells: a run would break that off.
        """
        if self.busy:
            raise PageRefusedError("the program runs already; stop it first")
        if reason := self._other_host.reason(self._looked_s):
            raise PageRefusedError(reason)
        self.reader = None
        self.coordinator = self._make()

    def stop(self) -> None:
        """End the program in order. Raises `PageRefusedError` where none runs."""
        if self.coordinator is None or not self.busy:
            raise PageRefusedError("no program runs")
        self.stops += 1
        self.coordinator.stop()

    def fail(self, text: str) -> None:
        """End the program, if one runs, with a fault: there is no way to the cells any more."""
        if self.coordinator is not None and self.busy:
            self.coordinator.fail(text)

    def stop_all(self) -> None:
        """End the program, or where another host drives the cells, take them all out of operation.

        A program brakes the wheels before it turns their drives off. Without a way to the cells
        they are taken out of operation once it is open again, before anything else is sent.
        """
        if self.coordinator is not None and self.busy and self.is_there():
            self.stop()
        else:
            self.stops += 1
            self._all_off = _REPEATS

    @property
    def wake_s(self) -> float:
        """When to poll next, if no frame comes before [s]."""
        wake_s = self._looked_s + IDLE_S
        if self.coordinator is not None:
            wake_s = min(wake_s, self.coordinator.wake_s)
        return wake_s if self.reader is None else min(wake_s, self.reader.wake_s)

    def on_frame(self, frame: Frame, now_s: float, bus: int = 0) -> None:
        """Somebody else's frame was on a bus."""
        self._other_host.on_frame(frame, now_s)
        if _is_request(frame):
            self._asked_s = now_s
        if self._watch is not None:
            self._watch.on_frame(frame, now_s, bus)
        if self._recent is not None:
            self._recent.on_received(frame, now_s, bus)
        reader = self.reader
        if reader is not None and bus == reader.bus and frame.can_id == reader.answers_id:
            reader.on_answer(frame.data, now_s)
        # A cell that comes back is set up meanwhile: each takes the answers to its own requests.
        if self.coordinator is not None:
            self.coordinator.on_frame(frame, now_s, bus)

    def poll(self, now_s: float) -> Iterable[Frame]:
        """The frames to send now, where there is one bus."""
        return [frame for _, frame in self.poll_buses(now_s)]

    def poll_buses(self, now_s: float) -> Iterable[tuple[int, Frame]]:
        """The frames to send now, each with its bus."""
        self._looked_s = now_s
        frames = self._off()
        if self.coordinator is not None:
            due_s = self.coordinator.wake_s
            if due_s <= now_s:
                self.on_cycle(now_s - due_s)
                frames += self.coordinator.poll_buses(now_s)
        if self.reader is not None:
            frames += [(self.reader.bus, frame) for frame in self.reader.poll(now_s)]
        if self._watch is not None:
            for bus, frame in frames:
                self._watch.on_frame(frame, now_s, bus)
        if self._recent is not None:
            for bus, frame in frames:
                self._recent.on_sent(frame, now_s, bus)
        return frames

    def _off(self) -> list[tuple[int, Frame]]:
        """The frames that take all cells out of 'operational', where no motor may run."""
        if not self._all_off or not self.is_there():
            return []
        self._all_off -= 1
        frame = nmt.command(nmt.ENTER_PRE_OPERATIONAL)
        return [(bus, frame) for bus in range(self._buses)]
