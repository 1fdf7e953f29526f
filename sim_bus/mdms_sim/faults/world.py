"""What goes wrong in the world: supplies, bridges, motors, wheels, encoders, sensors, parcels."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from random import Random

import numpy as np
from numpy.typing import NDArray

from mdms_model.scenario.fault import Fault
from mdms_sim.faults.course import Course, Kind, cells_with
from mdms_sim.nodes.bank import CellBank
from mdms_sim.physics.plane.control_step import UV_PER_V
from mdms_sim.physics.plane.handling import lift, push, set_down
from mdms_sim.physics.plane.world import World

#: The state of a wheel that counts the faults of a kind.
_OF_WHEELS = {
    "encoder_stuck": "encoder_stuck",
    "wheel_jammed": "jammed",
    "motor_reversed": "reversed",
}


class WorldFaults:
    """Faults of a world, and of what its cells measure of it; `kinds` by name.

    `places` has the place of each node, both from 0.
    Where two faults of wheels, sensors or parcels overlap, the last to end sets things right; of
    two of the supply the one that began last counts.
    """

    def __init__(self, world: World, bank: CellBank, places: NDArray[np.intp]) -> None:
        self._world = world
        self._bank = bank
        self._places = places
        self._bridges = world.bridges
        self._nominal_supply_v = world.bridges.supply_v.copy()
        self._supplies: list[Fault] = []
        self.kinds: Mapping[str, Kind] = {
            "supply": self._supply,
            "bridge_fault": self._bridge_fault,
            "sensor_stuck": self._sensor_stuck,
            **dict.fromkeys(_OF_WHEELS, self._wheel_fault),
            "push": self._push,
            "lift": self._lift,
            "wrong_place": self._wrong_place,
        }

    def _cells(self, fault: Fault) -> Sequence[int]:
        return cells_with(fault, len(self._nominal_supply_v))

    def _supply(self, fault: Fault, random: Random) -> Course:
        def begin() -> str | None:
            self._supplies.append(fault)
            self._supply_cells(fault)
            return "the motors are shorted" if fault.brake else None

        def end() -> None:
            self._supplies.remove(fault)
            self._supply_cells(fault)

        return Course(begin, end)

    def _supply_cells(self, changed: Fault) -> None:
        """Give the cells of a fault what the last of those at work says, or their own supply."""
        for cell in self._cells(changed):
            supply_v, shorted = self._nominal_supply_v[cell], False
            for fault in self._supplies:
                if cell in self._cells(fault):
                    supply_v, shorted = fault.supply_v, fault.brake
            self._bridges.supply_v[cell] = supply_v
            self._bridges.shorted[cell] = shorted
            self._bank.set_supply(cell, round(supply_v * UV_PER_V))

    def _bridge_fault(self, fault: Fault, random: Random) -> Course:
        def shut_off(value: int) -> None:
            for cell in self._cells(fault):
                self._bridges.shut_off[cell] = value

        return Course(partial(shut_off, 1), partial(shut_off, 0))

    def _sensor_stuck(self, fault: Fault, random: Random) -> Course:
        stuck = self._world.stuck_sensors[int(fault.covered)]
        sensors = list(fault.sensors or range(stuck.shape[1]))

        def hold(more: int) -> None:
            for cell in self._cells(fault):
                stuck[cell, sensors] += more

        def begin() -> str:
            hold(1)
            return f"{_listed('sensor', sensors)} {'covered' if fault.covered else 'free'}"

        return Course(begin, partial(hold, -1))

    def _wheel_fault(self, fault: Fault, random: Random) -> Course:
        counts = self._world.scene.state.wheels[_OF_WHEELS[fault.kind]]

        def count(more: int) -> None:
            for wheel in self._wheels(fault):
                counts[wheel] += more

        def begin() -> str | None:
            count(1)
            return _listed("axis", fault.axes) if fault.axes else None

        return Course(begin, partial(count, -1))

    def _wheels(self, fault: Fault) -> Iterator[int]:
        """The wheels of its axes, none named: all of a cell's."""
        first = self._world.wheels.first
        for cell in self._cells(fault):
            for axis in fault.axes or range(1, first[cell + 1] - first[cell] + 1):
                yield first[cell] + axis - 1

    def _push(self, fault: Fault, random: Random) -> Course:
        scene, parcel = self._world.scene, self._parcel(fault)

        def begin() -> str:
            if not push(scene, parcel, fault.impulse_n_s, fault.twist_nms):
                return "it is lifted, and not pushed"
            x_n_s, y_n_s = fault.impulse_n_s
            return f"{x_n_s:g}, {y_n_s:g} N s and {fault.twist_nms:g} N m s"

        return Course(begin, lambda: None)

    def _lift(self, fault: Fault, random: Random) -> Course:
        scene, parcel = self._world.scene, self._parcel(fault)

        def begin() -> None:
            lift(scene, parcel)

        def end() -> str:
            if not set_down(scene, parcel, fault.x_m, fault.y_m, fault.yaw_rad):
                return "it is still held"
            x_m, y_m, yaw_rad = self._world.pose[parcel]
            return f"set down at x {x_m:.4f} m, y {y_m:.4f} m, yaw {yaw_rad:.4f} rad"

        return Course(begin, end)

    def _wrong_place(self, fault: Fault, random: Random) -> Course:
        assert fault.as_cell is not None
        pair = [fault.cells[0] - 1, fault.as_cell - 1]

        def exchange() -> str:
            self._places[pair] = self._places[pair[::-1]]
            return f"it and cell {fault.as_cell} have changed places"

        return Course(exchange, exchange)

    def _parcel(self, fault: Fault) -> int:
        return [parcel.name for parcel in self._world.scenario.parcel].index(fault.parcel)


def _listed(noun: str, numbers: Sequence[int]) -> str:
    return f"{noun} {', '.join(map(str, numbers))}"
