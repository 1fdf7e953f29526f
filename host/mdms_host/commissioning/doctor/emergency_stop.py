"""The guided test of the emergency stop: cells are watched while a person presses and releases it.

The test only reads, and switches no motor on. `docs/wiring-stop.svg` draws the circuit that it
expects. In both forms the supply that cells measure (0x6079) falls below their limit (0x3003) at
once. With `category_1` it falls below 4.5 V when the time relay has cut the supply.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Protocol

from mdms_host.clock import Clock
from mdms_host.commissioning.doctor.findings import Finding
from mdms_host.commissioning.network import Commissioning, CommissioningError, SilentError
from mdms_protocol import indices
from mdms_protocol.codecs import cia402
from mdms_protocol.dictionary import AXES, AXIS_OFFSET
from mdms_protocol.emergencies import STOPPED_MEANWHILE, code_text

SHORT, CATEGORY_1 = "short", "category_1"
#: A contact takes less than 0.05 s; the rest is for a look at 126 cells.
FALLS_S = 0.5
#: The time relay's second, a tenth of it as its tolerance, and a look.
GONE_S = 1.6
#: Bridges do nothing below it.
BRIDGE_MIN_MV = 4500
#: From the first cell whose supply is back to the last.
BACK_S = 2.0
#: So long wheels are watched after the release.
WATCHED_S = 3.0
#: A wheel that a sleeve has touched moves less.
MOVED_M = 0.003
_LOOK_S = 0.01
_ON = (cia402.OPERATION_ENABLED, cia402.QUICK_STOP_ACTIVE, cia402.FAULT_REACTION)
#: Faults that an emergency stop, or the end of a run, leaves behind.
_LEFT_BEHIND = (0, 0x3220, 0x8130, 0x8250, STOPPED_MEANWHILE)


class StopTestError(CommissioningError):
    """The test cannot begin; the message has the node and the way out."""


class OwnFaultError(StopTestError):
    """A cell is in a fault that has nothing to do with the stop."""


class NobodyError(CommissioningError):
    """The person has not answered in time."""


class Person(Protocol):
    """The person at the button."""

    def ask(self, text: str) -> None:
        """Ask for something; earlier answers count no more."""
        ...

    def answered(self) -> bool:
        """Whether the answer has come: done."""
        ...


@dataclass(slots=True)
class _Watched:
    """One cell after the press; times in s on the clock, inf if not seen."""

    limit_mv: int
    supply_mv: int = 0
    fell_s: float = inf
    gone_s: float = inf
    silent: str | None = None


@dataclass(slots=True)
class StopTest:
    """The test on the cells of one bus; `run()` returns its findings."""

    commissioning: Commissioning
    clock: Clock
    person: Person
    form: str = SHORT
    limit_s: float = 60.0
    #: When each cell's supply fell after the first one's [s], of those whose has.
    fell_s: dict[int, float] = field(default_factory=dict)

    def run(self, node_ids: Iterable[int]) -> list[Finding]:
        """Ask, watch, and judge. Raises NobodyError, StopTestError, OwnFaultError."""
        cells = {node_id: self._before(node_id) for node_id in node_ids}
        findings = self._pressed(cells)
        if findings:
            return findings
        try:
            return self._released(cells) or self._stayed_off(cells)
        except SilentError:
            self._look(cells)
            if silent := _silent(cells):
                return silent
            raise

    # Before ----------------------------------------------------------------------------------

    def _before(self, node_id: int) -> _Watched:
        """A cell with its supply, and without a fault of its own."""
        for axis in range(AXES):
            if self._state(node_id, axis) != cia402.FAULT:
                continue
            code = self._read(node_id, indices.ERROR_CODE, axis)
            if code not in _LEFT_BEHIND:
                raise OwnFaultError(
                    f"node {node_id}, axis {axis + 1} is in fault, {code_text(code)}; remove the "
                    f"cause, then: mdms jog --node {node_id} --axis {axis + 1} --reset"
                )
        watched = _Watched(self.commissioning.read(node_id, indices.UNDERVOLTAGE_LIMIT))
        supply_mv = self.commissioning.read(node_id, indices.SUPPLY)
        if supply_mv < watched.limit_mv:
            raise StopTestError(
                f"node {node_id} measures {_volts(supply_mv)} already, {_volts(watched.limit_mv)} "
                "are needed; release the emergency stop and reset its module first"
            )
        return watched

    # Pressed ---------------------------------------------------------------------------------

    def _pressed(self, cells: dict[int, _Watched]) -> list[Finding]:
        """Wait for the press, until all cells have felt it or are too late."""
        self.person.ask("press the emergency stop, then Enter")
        end_s, asked_again_s = self.clock.now_s() + self.limit_s, inf
        first_s = inf
        while True:
            self._look(cells)
            now_s = self.clock.now_s()
            first_s = min((each.fell_s for each in cells.values()), default=inf)
            if all(self._done(each) for each in cells.values()):
                break
            if self.person.answered():
                asked_again_s = min(asked_again_s, now_s)
            # The moment of the press is that of the first cell, or of the answer.
            since_s = min(first_s, asked_again_s)
            if now_s > since_s + self._patience_s:
                break
            if since_s == inf and now_s > end_s:
                raise NobodyError(f"nobody has pressed the emergency stop for {self.limit_s:g} s")
            self.clock.sleep(_LOOK_S)
        self.fell_s = {
            node_id: each.fell_s - first_s for node_id, each in cells.items() if each.fell_s < inf
        }
        return self._after_the_press(cells, first_s)

    @property
    def _patience_s(self) -> float:
        return GONE_S if self.form == CATEGORY_1 else FALLS_S

    def _done(self, cell: _Watched) -> bool:
        seen_s = cell.gone_s if self.form == CATEGORY_1 else cell.fell_s
        return seen_s < inf or cell.silent is not None

    def _look(self, cells: dict[int, _Watched]) -> None:
        """Read the supply of every cell once."""
        for node_id, each in cells.items():
            if each.silent is not None:
                continue
            try:
                each.supply_mv = self.commissioning.read(node_id, indices.SUPPLY)
            except SilentError as error:
                each.silent = str(error)
                continue
            now_s = self.clock.now_s()
            if each.supply_mv < each.limit_mv:
                each.fell_s = min(each.fell_s, now_s)
            if each.supply_mv < BRIDGE_MIN_MV:
                each.gone_s = min(each.gone_s, now_s)

    def _after_the_press(self, cells: dict[int, _Watched], first_s: float) -> list[Finding]:
        if silent := _silent(cells):
            # Those that were looked at after a silent one were looked at too late to be judged.
            return silent
        late = _of(cells, lambda each: each.fell_s == inf or each.fell_s > first_s + FALLS_S)
        if len(late) == len(cells):
            text = f"no cell has lost its supply; they measure {_span(cells, late)}"
            return [Finding("stop-welded", text, tuple(late))]
        findings = [
            Finding("stop-welded", _lateness(cells[node], first_s), (node,)) for node in late
        ]
        if self.form == CATEGORY_1:
            there = _of(cells, lambda each: each.gone_s == inf)
            there = [node for node in there if node not in late]
            if there:
                text = f"{_span(cells, there)} {GONE_S:g} s after the stop was pressed"
                findings.append(Finding("stop-delay", text, tuple(there)))
        return findings

    # Released --------------------------------------------------------------------------------

    def _released(self, cells: dict[int, _Watched]) -> list[Finding]:
        """Wait until all cells have their supply back."""
        self.person.ask("release the emergency stop, and reset its module")
        end_s, first_s = self.clock.now_s() + self.limit_s, inf
        while True:
            self._look(cells)
            if silent := _silent(cells):
                return silent
            now_s = self.clock.now_s()
            without = _of(cells, lambda each: each.supply_mv < each.limit_mv)
            if len(without) < len(cells):
                first_s = min(first_s, now_s)
            if not without:
                return []
            if now_s > first_s + BACK_S:
                text = f"{_span(cells, without)} {BACK_S:g} s after other cells had theirs back"
                return [Finding("stop-stays", text, tuple(without))]
            if first_s == inf and now_s > end_s:
                raise NobodyError(f"nobody has released the emergency stop for {self.limit_s:g} s")
            self.clock.sleep(_LOOK_S)

    def _stayed_off(self, cells: dict[int, _Watched]) -> list[Finding]:
        """Watch states and wheels of all cells for a while."""
        places = [(node_id, axis) for node_id in cells for axis in range(AXES)]
        counts_per_m = {
            (node_id, axis): self._read(node_id, indices.RESOLUTION, axis)
            for node_id, axis in places
        }
        before = {place: self._read(place[0], indices.POSITION, place[1]) for place in places}
        found: dict[int, Finding] = {}
        end_s = self.clock.now_s() + WATCHED_S
        while self.clock.now_s() < end_s:
            for node_id, axis in places:
                state = self._state(node_id, axis)
                counts = self._read(node_id, indices.POSITION, axis) - before[node_id, axis]
                moved_m = abs(counts) / counts_per_m[node_id, axis]
                where = f"axis {axis + 1}"
                if state in _ON:
                    text = f"{where} is in {cia402.NAMES[state]!r}"
                elif moved_m > MOVED_M:
                    text = f"{where} has moved by {moved_m * 1e3:.0f} mm"
                else:
                    continue
                found.setdefault(node_id, Finding("stop-restarts", text, (node_id,)))
            self.clock.sleep(_LOOK_S)
        self._look(cells)
        again = _of(cells, lambda each: each.supply_mv < each.limit_mv)
        if again:
            raise StopTestError(
                f"node {again[0]} has lost its supply again; release the emergency stop, reset its "
                "module, and begin anew"
            )
        return list(found.values())

    def _state(self, node_id: int, axis: int) -> int | None:
        return cia402.state(self._read(node_id, indices.STATUSWORD, axis))

    def _read(self, node_id: int, index: int, axis: int) -> int:
        return self.commissioning.read(node_id, index + axis * AXIS_OFFSET)


def _of(cells: dict[int, _Watched], such: Callable[[_Watched], bool]) -> list[int]:
    return [node_id for node_id, each in cells.items() if such(each)]


def _silent(cells: dict[int, _Watched]) -> list[Finding]:
    silent = _of(cells, lambda each: each.silent is not None)
    return [Finding("stop-silent", cells[node].silent or "", (node,)) for node in silent]


def _lateness(cell: _Watched, first_s: float) -> str:
    if cell.fell_s == inf:
        return f"{_volts(cell.supply_mv)}, though the supply of other cells has fallen"
    late_s = cell.fell_s - first_s
    return f"its supply fell {late_s:.1f} s after the first cell's; {FALLS_S:g} s are allowed"


def _span(cells: dict[int, _Watched], node_ids: Sequence[int]) -> str:
    """The supplies of some cells, from the least to the most."""
    supplies_mv = sorted(cells[node_id].supply_mv for node_id in node_ids)
    least, most = _volts(supplies_mv[0]), _volts(supplies_mv[-1])
    return least if least == most else f"{least} to {most}"


def _volts(millivolts: int) -> str:
    return f"{millivolts / 1e3:.1f} V"
