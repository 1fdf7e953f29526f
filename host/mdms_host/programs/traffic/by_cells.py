"""Orders carried out by cells that steer: the host plans, and sends goals as ways become free."""

from collections.abc import Mapping, Sequence
from math import inf

import numpy as np

from mdms_host.estimation.belief import Belief, Gain
from mdms_host.estimation.parcel import Parcel
from mdms_host.layout import Layout
from mdms_host.motion.by_cells.program import CellsProgram
from mdms_host.motion.by_cells.stages import Followed
from mdms_host.motion.goal import Goal, Limits
from mdms_host.motion.trajectory.pushes import Mass
from mdms_host.programs.order import Order
from mdms_host.programs.traffic.legs import Legs
from mdms_host.programs.traffic.ordered import OrderedTraffic
from mdms_host.programs.traffic.planning import Desk
from mdms_host.programs.traffic.precedence import orders_over_cells
from mdms_host.programs.traffic.ride import Load
from mdms_host.routes.pace import TrapezoidPace
from mdms_host.routes.planner import Planner
from mdms_host.routes.route import Route
from mdms_host.routes.space.tiles import Tiles
from mdms_model.arrays import Floats
from mdms_protocol.neighbours import frames as wire

#: A cell is promised to one parcel at a time, so that tiles are no smaller than cells.
_TILES = 1
#: A parcel asks for the cells that it reaches before it can stand: some mm beyond where it is to,
#: and 4 mm around it.
_CLEARANCE_M = 0.01
_GAP_S = 0.2
#: The orders of parcels over each cell are made anew so often [s].
_ORDERS_S = 0.1
#: Cells are given a whole way of so many legs, even while the first is gone along in parts.
_LEGS = wire.LEGS_MAX


class CellsTraffic(OrderedTraffic[Legs]):
    """Traffic by way of `cells`; see `carrier.Traffic`. No way leads over a lost cell."""

    def __init__(
        self,
        layout: Layout,
        desk: Desk,
        loads: Mapping[str, Load],
        cells: CellsProgram,
        limits: Limits,
    ) -> None:
        pace = TrapezoidPace(limits.speed_m_s, limits.acceleration_m_s2)
        planner = Planner(
            Tiles(layout, _TILES),
            pace,
            clearance_m=_CLEARANCE_M,
            gap_s=_GAP_S,
            legs=_LEGS,
        )
        super().__init__(planner, desk, loads, over_lost=False)
        self._cells = cells
        self._limits = limits
        self._orders_due_s = -inf
        self._still: Floats = np.zeros(len(layout.wheel_cells))

    def know(self, parcel: Parcel, mass: Mass) -> None:
        """There is to be another parcel."""
        super().know(parcel, mass)
        self._cells.add(parcel)

    def on_lost_cells(self, cells: frozenset[int]) -> None:
        """See `OrderedTraffic`."""
        self._cells.on_lost_cells(cells)
        super().on_lost_cells(cells)

    def begin_again(self) -> None:
        """The cells' programs have ended; without the host they may have been on any leg by then.

        Parcels on their way are planned anew from where they lie.
        """
        for name in [name for name, ride in self._rides.items() if not ride.has_come]:
            self._end_ride(name)
        self._cells.begin_again()

    def take_notices(self) -> list[str]:
        """See `OrderedTraffic`."""
        return super().take_notices() + self._cells.take_notices()

    def step(self, beliefs: Mapping[str, Belief], step_s: float) -> Floats:
        """References of all wheels (W,): 0, for the host commands none."""
        for name in self._rides.keys() - beliefs.keys():
            # A parcel that is not found is not steered, and planned anew where it is found.
            self._end_ride(name)
        self._advance(beliefs, step_s)
        for _, ride, belief, limit_m in self._under_way(beliefs):
            ride.step(belief, step_s, limit_m)
            if not ride.at_rest:
                self._moved_s = self._now_s
        if self._cells.goes_on:
            self._set_orders()
        return self._still

    @property
    def speeds_m_s(self) -> Floats:
        """How fast each wheel is to run, (W,): what cells command is not known."""
        return self._still

    @property
    def gains(self) -> Mapping[str, Gain]:
        """Nothing: what cells push with is not known."""
        return {}

    def _set_orders(self) -> None:
        """Have cells get the order over them, of parcels as far as these would go by themselves."""
        if self.plan is None or self._now_s < self._orders_due_s:
            return
        self._orders_due_s = self._now_s + _ORDERS_S
        come_m = {name: ride.progress_m for name, ride in self._rides.items()}
        until_m = {name: ride.given_m for name, ride in self._rides.items()}
        reservations = self.plan.authority.reservations
        self._cells.set_orders(orders_over_cells(reservations, self._tiles, come_m, until_m))

    def _set_out(self, order: Order, route: Route) -> Legs:
        def send(goal: Goal, legs: Sequence[Goal]) -> Followed:
            return self._cells.lead(order.parcel, goal, legs)

        load = self._loads[order.parcel]
        acceleration_m_s2, goes_on = self._limits.acceleration_m_s2, self._cells.goes_on
        return Legs(order, route, load, send, acceleration_m_s2, goes_on=goes_on)

    def _end_ride(self, name: str) -> None:
        super()._end_ride(name)
        self._cells.end(name)
