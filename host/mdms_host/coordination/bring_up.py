"""One cell on its way through the phases: the commands it needs next, and its faults."""

from collections.abc import Iterable, Iterator, Mapping

from mdms_host.can_link.emergencies import error_text
from mdms_host.can_link.protocol_revision import other_protocol
from mdms_host.can_link.remote_cell import RemoteCell
from mdms_host.can_link.sdo_client import Read, SdoClient, Setting
from mdms_host.coordination.configuration import SIGNATURE, Configuration
from mdms_host.coordination.phase import STOPPED, Phase
from mdms_protocol import cia402, cob, indices, nmt, pdo
from mdms_protocol.dictionary import ENTRIES
from mdms_protocol.entry import steps_per_unit
from mdms_protocol.frame import Frame

#: Where a cell reports the revision of its object table.
REVISION = Read(indices.IDENTITY, 3)
_TOWARDS_ENABLED: Mapping[int | None, int] = dict(cia402.TOWARDS_ENABLED.items())


class BringUpCell(RemoteCell):
    """A cell of which the first `axes` are used, and which gets these settings when it comes up.

    Then all of its stored settings must be what the run expects: the table's defaults, and these.
    One that differs is a trouble, whatever it is: a stored polarity turns a wheel the wrong way, a
    stored time-out lets it drive on alone.
    """

    def __init__(self, number: int, node_id: int, axes: int, settings: Iterable[Setting]) -> None:
        super().__init__(number, node_id)
        self._axes = axes
        self._all_enabled = (cia402.OPERATION_ENABLED,) * axes
        settings = tuple(settings)
        self._configuration = Configuration(node_id, settings)
        self._identity = SdoClient(node_id, (REVISION,))
        self._sdo = SdoClient(node_id, (*settings, SIGNATURE))
        self._verified = False
        self._mismatch: str | None = None
        self.handlers[cob.SDO_RESPONSE_BASE + node_id] = self.on_answer

    @property
    def enabled(self) -> bool:
        """Whether all axes that are used are in 'operation enabled'."""
        states = self.drive_states
        return states is not None and states[: self._axes] == self._all_enabled

    @property
    def debounce_s(self) -> float:
        """How late it reports a change of its presence sensors, by its settings [s]."""
        entry = ENTRIES[indices.PRESENCE_DEBOUNCE, 0]
        return self._configuration.values[entry.index, 0] / steps_per_unit(entry.unit)

    @property
    def other_protocol(self) -> str | None:
        """What there is to say of a cell that speaks another revision of the protocol."""
        revision = self._identity.answers.get((REVISION.index, REVISION.sub))
        return None if revision is None else other_protocol(revision)

    def on_answer(self, data: bytes, now_s: float) -> None:
        """An answer to a setting, or to the question who it is."""
        self._identity.on_response(data)
        self._sdo.on_response(data)
        if self._sdo.done and not self._verified:
            self._verify()

    def has_reached(self, phase: Phase) -> bool:
        """Whether the cell has reached what a phase is for."""
        match phase:
            case Phase.WAITING:
                return self.nmt_state == nmt.PRE_OPERATIONAL
            case Phase.IDENTIFYING:
                return self._identity.done
            case Phase.CONFIGURING:
                return self._verified
            case Phase.STARTING:
                return self.nmt_state == nmt.OPERATIONAL
            case Phase.ENABLING:
                return self.enabled
            case _:
                return not self.moving

    def fault(self, phase: Phase) -> str | None:
        """The cell's fault in a phase; None if it has none."""
        if self._identity.failure:
            return f"{self.name} cannot be identified: {self._identity.failure}"
        if self._sdo.failure:
            return f"{self.name} cannot be set up: {self._sdo.failure}"
        if self._mismatch:
            return f"{self.name} is not set up as this run expects: {self._mismatch}"
        if phase in (Phase.ENABLING, Phase.RUNNING) and self.nmt_state != nmt.OPERATIONAL:
            return f"{self.name} is no longer operational: it has restarted or was stopped"
        if phase == Phase.RUNNING and not self.enabled:
            errors = "".join(f"; {error_text(*error)}" for error in self.errors.items())
            return f"{self.name} has disabled its drives: {self.drive_text}{errors}"
        return None

    def commands(self, phase: Phase, now_s: float) -> Iterator[Frame]:
        """The commands that the cell still needs in a phase."""
        if phase == Phase.WAITING and self.nmt_state in (nmt.OPERATIONAL, nmt.STOPPED):
            # Left over from an earlier run: it begins anew, and reports its state again.
            yield nmt.command(nmt.ENTER_PRE_OPERATIONAL, self.node_id)
        elif phase == Phase.IDENTIFYING:
            yield from self._identity.poll(now_s)
        elif phase == Phase.CONFIGURING:
            yield from self._sdo.poll(now_s)
        elif phase == Phase.STARTING and self.nmt_state != nmt.OPERATIONAL:
            yield nmt.command(nmt.START, self.node_id)
        elif phase == Phase.ENABLING and not self.enabled:
            yield from self._enable()
        elif phase in (Phase.STOPPING, Phase.FAILING):
            yield self._control(cia402.QUICK_STOP)
        elif phase in STOPPED:
            yield self._control(cia402.DISABLE_VOLTAGE)

    def _verify(self) -> None:
        """Compare the signature; where it differs, read what does."""
        answers = self._sdo.answers
        values = self._configuration.values
        if answers[SIGNATURE.index, SIGNATURE.sub] == self._configuration.signature:
            self._verified = True
        elif answers.keys() >= values.keys():
            self._mismatch = self._configuration.differences(answers)
        else:
            self._sdo.append(Read(*place) for place in values)

    def _enable(self) -> Iterator[Frame]:
        """The controlwords that take the drives one step nearer to 'operation enabled'."""
        states = self.drive_states or (None,) * len(pdo.CONTROLWORD.entries)
        words = tuple(_TOWARDS_ENABLED.get(state, cia402.SHUTDOWN) for state in states)
        if cia402.FAULT_RESET in words:
            # The reset is an edge of its bit, so the bit must have been low.
            yield self._control(cia402.DISABLE_VOLTAGE)
        yield Frame(pdo.CONTROLWORD.can_id(self.node_id), pdo.CONTROLWORD.encode(words))

    def _control(self, word: int) -> Frame:
        """The same controlword for all axes."""
        words = (word,) * len(pdo.CONTROLWORD.entries)
        return Frame(pdo.CONTROLWORD.can_id(self.node_id), pdo.CONTROLWORD.encode(words))
