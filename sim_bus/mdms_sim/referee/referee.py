"""The referee: it watches frames, faults and wheels of a run, and notes what breaks a rule.

It imports neither the firmware nor the host, so it cannot share their mistakes. Each judge has some
of the rules; the referee passes on what happens, in its order.
"""

from mdms_model.run.record import Event
from mdms_model.scenario.fault import Fault
from mdms_protocol.codecs.frame import Frame
from mdms_sim.physics.plane.control_step import Registers
from mdms_sim.referee.claims import Claims
from mdms_sim.referee.parcels import Parcels
from mdms_sim.referee.rules import Violation
from mdms_sim.referee.truth import Truth, Word
from mdms_sim.referee.wheels import WheelReferee

NS_PER_S = 1_000_000_000
#: Parcels are looked at this often, words and wheels under parcels that often [ticks of 1 ms].
LOOK_TICKS = 10
LISTEN_TICKS = 50


class Referee:
    """Judges one run by the rules of `RULES`; `violations` fills up as it goes on.

    `watched[bus]` has the identifiers on that bus (from 0) that it wants to see, `delivered` those
    that it wants to see when they have reached a cell.
    """

    def __init__(self, truth: Truth) -> None:
        self.violations: list[Violation] = []
        self._now_ns = 0
        self._ticks = 0
        self._wheels = WheelReferee(truth, self._note)
        self._word = Word(truth)
        self._parcels = Parcels(truth, self._note, self._word)
        self._claims = Claims(truth, self._note, self._word)
        self._judges = self._wheels, self._parcels, self._claims
        buses = range(truth.addresses.bus_count)
        self._listening = [self._listeners_on(bus) for bus in buses]
        self.watched = [listening.keys() for listening in self._listening]
        self.delivered = self._wheels.delivered

    def on_frame(self, bus: int, frame: Frame, now_ns: int) -> None:
        """A watched frame has got through on a bus, from 0."""
        self._now_ns = now_ns
        for listener in self._listening[bus][frame.can_id]:
            listener.on_frame(bus, frame, now_ns)

    def on_delivery(self, cell: int, frame: Frame, now_ns: int) -> None:
        """A frame of another node has reached a cell, from 0."""
        self._now_ns = now_ns
        self._wheels.on_delivery(cell, frame, now_ns)

    def on_fault(self, fault: Fault, begins: bool, now_ns: int) -> None:
        """A fault of the scenario, or one by hand, begins or ends."""
        self._now_ns = now_ns
        for judge in self._judges:
            judge.on_fault(fault, begins, now_ns)

    def measures_high(self, cell: int) -> None:
        """A cell, from 0, measures the full supply from now on, even when it is low."""
        self._wheels.measures_high(cell)

    def on_tick(self, now_ns: int, voltage_uv: Registers) -> None:
        """The cells have ticked, and hold these voltages (cells, 2), by their places."""
        self._now_ns = now_ns
        self._wheels.on_tick(now_ns, voltage_uv)
        self._ticks += 1
        if self._ticks % LOOK_TICKS == 0:
            self._parcels.look(now_ns)
        if self._ticks % LISTEN_TICKS == 0:
            report = self._claims.report()
            self._parcels.look_at_wheels(now_ns, voltage_uv, report)
            self._claims.look(now_ns, report)

    def finish(self) -> None:
        """The run is over."""
        self._parcels.look(self._now_ns)
        self._claims.finish(self._now_ns)

    def _listeners_on(self, bus: int) -> dict[int, list[Word | WheelReferee | Parcels]]:
        """The listeners to each identifier of a bus, `word` before the judges that read it."""
        listening: dict[int, list[Word | WheelReferee | Parcels]] = {}
        for listener in (self._word, self._wheels, self._parcels):
            for can_id in listener.watched(bus):
                listening.setdefault(can_id, []).append(listener)
        return listening

    @property
    def unavoidable(self) -> list[Event]:
        """Touches and falls that full braking could not have avoided: no violations."""
        return self._parcels.unavoidable

    @property
    def events(self) -> list[Event]:
        """The violations as events of the run."""
        return [
            Event(
                each.time_s,
                "violation",
                f"{each.rule}: {each.text}",
                parcel=each.parcel,
                cell=each.cell,
            )
            for each in self.violations
        ]

    def _note(
        self, rule: str, text: str, *, cell: int | None = None, parcel: str | None = None
    ) -> None:
        time_s = self._now_ns / NS_PER_S
        self.violations.append(Violation(time_s, rule, text, cell, parcel))
