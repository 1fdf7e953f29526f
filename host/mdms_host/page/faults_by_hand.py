"""Faults that a person has begin and end in a simulation, each as a scenario's would."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from mdms_host.page.commands import EndFault, RefusedError
from mdms_model.scenario.fault import Fault
from mdms_model.scenario.rules.fault import check_faults
from mdms_model.scenario.scenario import Scenario, ScenarioError
from mdms_model.scenario.tree import plain
from mdms_sim.faults.node import PRIORITY
from mdms_sim.faults.schedule import Ongoing
from mdms_sim.simulation import NS_PER_S, Simulation

#: Of these a cell has one or none.
_ONCE = ("off", "hang")


@dataclass(frozen=True, slots=True)
class _Begun:
    since_s: float
    ongoing: Ongoing


class FaultsByHand:
    """The faults at work, by number; `on_change` is called when one begins or ends."""

    def __init__(
        self, simulation: Simulation, scenario: Scenario, on_change: Callable[[], object]
    ) -> None:
        self._simulation = simulation
        self._scenario = scenario
        self._on_change = on_change
        self._begun: dict[int, _Begun] = {}
        self._count = 0

    def begin(self, fault: Fault) -> int:
        """Have one begin; returns its number. Raises `RefusedError`."""
        if fault.start_s:
            raise RefusedError("fault.start_s: a fault begins at once; leave it out")
        self._check(fault)
        self._check_once(fault)
        self._count += 1
        number, kernel = self._count, self._simulation.kernel
        ongoing = self._simulation.faults.begin(fault)
        if fault.kind != "push":
            self._begun[number] = _Begun(kernel.now_ns / NS_PER_S, ongoing)
            self._on_change()
        if fault.duration_s is not None:
            end_ns = kernel.now_ns + round(fault.duration_s * NS_PER_S)
            kernel.at(end_ns, PRIORITY, lambda: self._end_by_itself(number))
        return number

    def end(self, command: EndFault) -> None:
        """Have one end. Raises `RefusedError`."""
        begun = self._begun.get(command.number)
        if begun is None:
            raise RefusedError(f"there is no fault {command.number}")
        pose = {"x_m": command.x_m, "y_m": command.y_m, "yaw_rad": command.yaw_rad}
        given: dict[str, Any] = {name: value for name, value in pose.items() if value is not None}
        if given:
            if begun.ongoing.fault.kind != "lift":
                raise RefusedError("only a parcel that was lifted is set down somewhere")
            self._check(replace(begun.ongoing.fault, duration_s=1.0, **given))
        del self._begun[command.number]
        self._simulation.faults.end(begun.ongoing, **given)
        self._on_change()

    def let_go(self) -> None:
        """Set down what is lifted, where it was."""
        for number, begun in list(self._begun.items()):
            if begun.ongoing.fault.kind == "lift":
                self.end(EndFault(number))

    def message(self) -> dict[str, Any]:
        """The message `faults`."""
        faults = [
            {"number": number, "since_s": begun.since_s, "fault": _chosen(begun.ongoing.fault)}
            for number, begun in self._begun.items()
        ]
        return {"kind": "faults", "faults": faults}

    def _end_by_itself(self, number: int) -> None:
        if number in self._begun:
            self.end(EndFault(number))

    def _check(self, fault: Fault) -> None:
        try:
            check_faults(replace(self._scenario, fault=(fault,)))
        except ScenarioError as error:
            raise RefusedError(str(error).replace("fault.0", "fault")) from None

    def _check_once(self, fault: Fault) -> None:
        """A cell that has no power has none to lose, and a parcel in the hand is lifted already."""
        cells = range(1, self._scenario.array.columns * self._scenario.array.rows + 1)
        for begun in self._begun.values():
            other = begun.ongoing.fault
            if fault.kind == other.kind and fault.kind in _ONCE:
                again = set(fault.cells or cells) & set(other.cells or cells)
                if again:
                    raise RefusedError(f"cell {min(again)}: {fault.kind} already")
            if fault.kind == other.kind == "lift" and fault.parcel == other.parcel:
                raise RefusedError(f"{fault.parcel} is lifted already")


def _chosen(fault: Fault) -> dict[str, Any]:
    """What of a fault differs from what it comes with."""
    usual = plain(Fault(fault.kind))
    values = plain(fault).items()
    return {"kind": fault.kind} | {key: value for key, value in values if usual.get(key) != value}
