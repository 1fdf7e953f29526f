"""The rules of the referee as one table, which the documents print."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Rule:
    """One rule; `safety` rules may never be violated, whatever fails."""

    name: str
    safety: bool
    text: str


@dataclass(frozen=True, slots=True)
class Violation:
    """A rule was broken at `time_s` [s], by a cell (number from 1) or about a parcel."""

    time_s: float
    rule: str
    text: str
    cell: int | None = None
    parcel: str | None = None


#: All rules, in the order in which they are printed.
RULES = {
    rule.name: rule
    for rule in (
        Rule(
            "asked",
            True,
            "After power-up, a reset, a fault, NMT stop, quick stop, or 5 ms of supply below the "
            "limit, a wheel gets no voltage until a later controlword from another node enables "
            "it: 'enable operation', or 'switch on' where cells steer. Braking is allowed. A rest "
            "for want of promises is no stop.",
        ),
        Rule(
            "heeded",
            True,
            "After a stop (quick stop, 'disable voltage', NMT stop, reset, fault), an END or a "
            "lapsed lease, voltage and wheel speed fall within the documented time. A ramped stop "
            "is over within 1.3 v2/2a and the reaction way, where the wheel carries nothing; until "
            "it is, braking is allowed for 0x3004. So is holding still after an END, where another "
            "node has switched the wheel on since. A cell whose measurement of the supply is stuck "
            "has 50 ms, in which the host hears of it from others.",
        ),
        Rule(
            "silent",
            True,
            "After the last valid setpoint, SYNC or heartbeat, no wheel is pushed onward for "
            "longer than documented. A hung cell has the time of its watchdog (0.5 s on the "
            "slowest board). One whose watchdog is dead as well (`hang` without `duration_s`) is "
            "the documented single point of failure: nothing is asked of it.",
        ),
        Rule(
            "one_parcel",
            True,
            "No cell drives for a parcel that is not over it while another is; it has 0.3 s to "
            "notice. No cell is promised to two: a promise counts for 80 ms.",
        ),
        Rule(
            "apart",
            True,
            "A run makes no parcels touch, tips none, and loses none over an edge except at an "
            "exit. A touch that full braking from the event could not avoid is counted apart, and "
            "so is what a hand pushes or sets down. An open-loop field promises no distance.",
        ),
        Rule(
            "true",
            False,
            "'Arrived' is said at a believed 3 mm and 1 degree, and means a truth within 5 mm and "
            "2 degrees at that instant. Without a host it is the word of most cells under the "
            "parcel for 0.5 s. Exit code 0 means that everything asked for has happened. What a "
            "hand moves after it has arrived had arrived.",
        ),
        Rule(
            "said",
            False,
            "A fault that stops a parcel is reported within 2 s, on the bus if the host is dead. "
            "A run that cannot end says why within 30 s: that long no parcel away from its goal "
            "has moved 2 mm.",
        ),
        Rule(
            "quiet",
            True,
            "From 0.5 s after its parcel has left, a wheel gets no voltage that turns it, unless "
            "somebody asked: a setpoint that is not 0, where the host steers. A cell in another's "
            "place may drive for a parcel at its own place, of which its neighbours tell it.",
        ),
    )
}
