"""The cells of a layout on their way through the phases: their next commands, and their faults."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import inf

from mdms_host.can_link.remote_cell import RemoteCell
from mdms_host.can_link.sdo_client import PATIENT, SdoClient, Setting
from mdms_host.coordination.cell_setup import (
    Configuration,
    Identification,
    SetUp,
    steering_settings,
    taken_back,
)
from mdms_host.coordination.run_state import STOPPED, Phase
from mdms_host.layout import Layout
from mdms_host.places import Place, all_values
from mdms_protocol import indices, pdo
from mdms_protocol.codecs import cia402, cob, nmt
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.dictionary import ENTRIES
from mdms_protocol.emergencies import error_text
from mdms_protocol.entry import OutOfRangeError, steps_per_unit

_TOWARDS_ENABLED: Mapping[int | None, int] = dict(cia402.TOWARDS_ENABLED.items())
#: The neighbour layer of a cell takes its drives on from 'switched on', and back.
_TOWARDS_SWITCHED_ON = {**_TOWARDS_ENABLED, cia402.SWITCHED_ON: cia402.SWITCH_ON}
_ENABLED = frozenset((cia402.OPERATION_ENABLED,))
#: A cell that refuses each start for so long stands in another's place [s].
REFUSED_S = 0.2
_LED = frozenset((cia402.SWITCHED_ON, cia402.OPERATION_ENABLED))


@dataclass(frozen=True, slots=True)
class ExpectedCells:
    """Settings that a run writes to the cells of its layout, and checks of these cells.

    `settings` are written to every cell, `own_settings` to the cell of that number besides. All
    other stored settings must be at their defaults. The cell of a number in `serials` must have
    that serial number. With `asks_boards` the boards of cells that steer must be able to.
    """

    settings: tuple[Setting, ...] = ()
    own_settings: Mapping[int, tuple[Setting, ...]] = field(default_factory=dict)
    serials: Mapping[int, int] = field(default_factory=dict)
    asks_boards: bool = True


class BringUpCell(RemoteCell):
    """The cell of a number, from 1, that gets its settings when it comes up.

    Then all of its stored settings must be as the run expects: the table's defaults, and these. Any
    difference is a trouble: a stored polarity turns a wheel the wrong way, and a stored time-out
    lets it drive on alone. Only those of its place do not matter where it does not steer
    (`Configuration`), and those of `steering_settings` are set back where a run has left them
    behind. With `steers` the cell enables its drives by itself, and these settings are taken back
    at the end. `identification` is what it is. Raises `OutOfRangeError` for a place that does not
    fit the wire, where it steers.
    """

    def __init__(
        self,
        number: int,
        layout: Layout,
        expected: ExpectedCells,
        *,
        status_period_s: float,
        steers: bool,
    ) -> None:
        node_id, bus = layout.node_ids[number - 1], layout.buses[number - 1]
        super().__init__(number, node_id, bus if layout.bus_count > 1 else None)
        self._axes = axes = len(layout.wheels)
        self.steers = steers
        self._ready = _LED if steers else _ENABLED
        self._towards_ready = _TOWARDS_SWITCHED_ON if steers else _TOWARDS_ENABLED
        self._set_back = SdoClient(node_id, taken_back() if steers else (), attempts=PATIENT)
        # Cells report their state on change, and repeat it, which makes up for a lost frame.
        repeated = Setting(indices.TPDO_PARAMETERS + 1, 5, round(status_period_s * 1e3))
        self._settings = (
            repeated,
            *expected.settings,
            *(_placing(layout, number) if steers else ()),
            *expected.own_settings.get(number, ()),
            # Last, so that a cell steers with its place only.
            *(steering_settings() if steers else ()),
        )
        spare = {} if steers else _spare(layout, number)
        self._configuration = Configuration(node_id, self._settings, spare)
        serial, asks_board = expected.serials.get(number), steers and expected.asks_boards
        self.identification = Identification(
            node_id, axes, serial, kept=repeated, asks_board=asks_board
        )
        self._set_up = SetUp(node_id, self._settings, self._configuration)
        self.restarted = False
        self._written = False
        self._ending_s = inf
        self.handlers[cob.SDO_RESPONSE_BASE + node_id] = self.on_answer

    @property
    def enabled(self) -> bool:
        """Whether all axes that are used are enabled, or the cell's own to enable."""
        states = self.drive_states
        return states is not None and self._ready.issuperset(states[: self._axes])

    @property
    def driven(self) -> tuple[bool, ...]:
        """Whether each axis that is used may be driven now."""
        states = self.drive_states or (None,) * self._axes
        return tuple(state != cia402.SWITCHED_ON for state in states[: self._axes])

    @property
    def may_drive(self) -> bool:
        """Whether it has not told, since its end began, that its drives brake or are off.

        A cell that was never heard was never driven.
        """
        if self._heard_s <= self._ending_s:
            return self._heard_s > -inf
        if self.drive_states is None:
            return self.nmt_state in (None, nmt.OPERATIONAL)
        return not self._ready.isdisjoint(self.drive_states)

    @property
    def _setting_back(self) -> bool:
        """Whether settings are still to be taken back; none are where none were written."""
        return self._written and not (self._set_back.done or self._set_back.failure)

    @property
    def debounce_s(self) -> float:
        """How late it reports a change of its presence sensors, by its settings [s]."""
        entry = ENTRIES[indices.PRESENCE_DEBOUNCE, 0]
        return self._configuration.values[entry.index, 0] / steps_per_unit(entry.unit)

    @property
    def mismatch(self) -> str | None:
        """The unexpected stored settings, in words; None if there is none so far."""
        mismatch = self._set_up.mismatch
        return mismatch and f"not set up as this run expects: {mismatch}"

    def begin_again(self) -> None:
        """Come up anew, by reports that the cell sends from now on alone."""
        self.nmt_state, self.drive_states, self.restarted = None, None, False
        self.identification.begin_again()
        self._set_up = SetUp(self.node_id, self._settings, self._configuration)

    def on_heartbeat(self, data: bytes, now_s: float) -> None:
        """A heartbeat; `restarted` is whether it has announced a start since it was operational."""
        super().on_heartbeat(data, now_s)
        if self.nmt_state in (nmt.INITIALISING, nmt.OPERATIONAL):
            self.restarted = self.nmt_state == nmt.INITIALISING
        if self.nmt_state != nmt.OPERATIONAL:
            # All drives are off, and earlier reports of them are void.
            self.drive_states = None

    def on_answer(self, data: bytes, now_s: float) -> None:
        """Take in an answer to a setting or to a read of the identity."""
        self.identification.on_response(data)
        if self._ending_s < inf:
            # Answers that the bring-up still waits for are of no interest any more.
            self._set_back.on_response(data)
        else:
            self._set_up.on_response(data)

    def has_reached(self, phase: Phase) -> bool:
        """Whether the cell has reached the aim of a phase."""
        match phase:
            case Phase.WAITING:
                return self.nmt_state == nmt.PRE_OPERATIONAL
            case Phase.IDENTIFYING:
                return self.identification.done
            case Phase.CONFIGURING:
                return self._set_up.verified or self.mismatch is not None
            case Phase.STARTING:
                return self.nmt_state == nmt.OPERATIONAL
            case Phase.ENABLING:
                return self.enabled
            case _:
                return not (self.moving or self.may_drive or self._setting_back)

    def fault(self, phase: Phase) -> str | None:
        """The cell's fault in a phase; None if it has none."""
        if self.identification.failure:
            return f"{self.name} cannot be identified: {self.identification.failure}"
        if self._set_up.failure:
            return f"{self.name} cannot be set up: {self._set_up.failure}"
        if phase in (Phase.ENABLING, Phase.RUNNING) and self.nmt_state != nmt.OPERATIONAL:
            text = f"{self.name} is no longer operational: it has restarted or was stopped"
            return "; ".join([text, *self._error_texts])
        if phase == Phase.RUNNING and not self.enabled:
            return f"{self.name} has disabled its drives: {self.drives_text}"
        return None

    @property
    def drives_text(self) -> str:
        """The states of the drives in words, and the errors that stand."""
        return "; ".join([self.drive_text, *self._error_texts])

    @property
    def _error_texts(self) -> list[str]:
        return [error_text(*error) for error in self.errors.items()]

    def commands(self, phase: Phase, now_s: float) -> Iterator[Frame]:
        """The commands that the cell still needs in a phase."""
        if phase == Phase.WAITING and self.nmt_state in (nmt.OPERATIONAL, nmt.STOPPED):
            # Left over from an earlier run: it begins anew, and reports its state again.
            yield nmt.command(nmt.ENTER_PRE_OPERATIONAL, self.node_id)
        elif phase == Phase.IDENTIFYING:
            yield from self.identification.poll(now_s)
        elif phase == Phase.CONFIGURING:
            self._written = True
            yield from self._set_up.poll(now_s)
        elif phase == Phase.STARTING and self.nmt_state != nmt.OPERATIONAL:
            yield nmt.command(nmt.START, self.node_id)
        elif phase == Phase.ENABLING and not self.enabled and not self.lacks_supply:
            # A person presses an emergency stop: no program resets that fault in the same run.
            yield from self._enable()
        elif phase in (Phase.STOPPING, Phase.FAILING):
            yield self._control(cia402.QUICK_STOP)
            self._ending_s = min(self._ending_s, now_s)
            if self._setting_back:
                yield from self._set_back.poll(now_s)
        elif phase in STOPPED:
            yield self._control(cia402.DISABLE_VOLTAGE)

    def _enable(self) -> Iterator[Frame]:
        """The controlwords that take the drives one step nearer to 'operation enabled'."""
        states = self.drive_states or (None,) * len(pdo.CONTROLWORD.entries)
        words = tuple(self._towards_ready.get(state, cia402.SHUTDOWN) for state in states)
        if cia402.FAULT_RESET in words:
            # The reset is an edge of its bit, so the bit must have been low.
            yield self._control(cia402.DISABLE_VOLTAGE)
        yield Frame(pdo.CONTROLWORD.can_id(self.node_id), pdo.CONTROLWORD.encode(words))

    def _control(self, word: int) -> Frame:
        """The same controlword for all axes."""
        words = (word,) * len(pdo.CONTROLWORD.entries)
        return Frame(pdo.CONTROLWORD.can_id(self.node_id), pdo.CONTROLWORD.encode(words))


def _placing(layout: Layout, number: int) -> Iterator[Setting]:
    """Settings of a cell's place. Raises `OutOfRangeError`."""
    for place, value in all_values(layout, number).items():
        yield Setting(*place, value)


def _spare(layout: Layout, number: int) -> dict[Place, int]:
    """Settings of its place that a cell may have; none if the place does not fit the wire."""
    try:
        return all_values(layout, number)
    except OutOfRangeError:
        return {}
