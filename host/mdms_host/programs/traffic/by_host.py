"""Orders carried out by the host: it sets every wheel, and each parcel follows its trajectory."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from types import MappingProxyType

from mdms_host.estimation.belief import Belief, Gain
from mdms_host.motion.carrying import Carrying
from mdms_host.motion.trajectory.follower import Carried, Grip
from mdms_host.motion.trajectory.traction import Traction
from mdms_host.programs.order import Order
from mdms_host.programs.traffic.dispatch import KeptFree, PlanExecutor, WayRules
from mdms_host.programs.traffic.ordered import OrderedTraffic, planner_of
from mdms_host.programs.traffic.ride import Load, Ride
from mdms_host.routes.planner import SearchSettings
from mdms_host.routes.route import Pace, Route
from mdms_model.arrays import Floats

#: Tiles along a cell's side: the finer, the nearer parcels may pass each other. Places that ways
#: lead over are so many tiles apart.
_TILES, _STEP = 4, 2
#: Outlines are planned so much larger on all sides [m], and so much apart in time [s].
_CLEARANCE_M = 0.008
_GAP_S = 0.1


class TableTraffic(OrderedTraffic[Ride]):
    """Traffic on the wheels of `traction`; see `OrderedTraffic`."""

    def __init__(
        self,
        traction: Traction,
        pace: Pace,
        executor: PlanExecutor,
        loads: Mapping[str, Load],
        *,
        kept_free: Sequence[KeptFree] = (),
        told: Mapping[str, Floats] = MappingProxyType({}),
        hangs: bool = False,
    ) -> None:
        planner = planner_of(
            traction.layout,
            _TILES,
            pace,
            SearchSettings(step=_STEP),
            clearance_m=_CLEARANCE_M,
            gap_s=_GAP_S,
            hangs=hangs,
        )
        super().__init__(planner, executor, loads, WayRules(kept_free), told=told)
        self._traction = traction
        self._carrying = Carrying(traction.layout, traction.drives)
        self._grips: dict[str, Grip] = {}
        #: Parcels whose wheels slip by the present estimate.
        self._slipping: set[str] = set()

    def on_lost_cells(self, cells: frozenset[int]) -> None:
        """See `OrderedTraffic`; their wheels drag."""
        self._traction.lose(cells)
        super().on_lost_cells(cells)

    def step(self, beliefs: Mapping[str, Belief], step_s: float) -> Floats:
        """References of all wheels (W,) [m/s] for the next cycle."""
        self._advance(beliefs, step_s)
        carried = dict(self._drive(beliefs, step_s))
        if carried:
            self._moved_s = self._now_s
        return self._carrying.references_m_s(carried, self._where.outlines, self._where.places)

    @property
    def near(self) -> Collection[str]:
        """See `OrderedTraffic`."""
        return [name for name, ride in self._rides.items() if ride.may_feel]

    @property
    def speeds_m_s(self) -> Floats:
        """See `OrderedTraffic`."""
        return self._carrying.speeds_m_s

    @property
    def gains(self) -> Mapping[str, Gain]:
        """See `OrderedTraffic`."""
        return self._carrying.gains

    def _set_out(self, order: Order, route: Route) -> Ride:
        grip = self._grips.setdefault(order.parcel, Grip())
        return Ride(order, route, self._loads[order.parcel], self._traction, grip)

    def _remove(self, name: str) -> None:
        super()._remove(name)
        self._grips.pop(name, None)

    def _report_slip(self, name: str, grip: Grip) -> None:
        """Report the first time that a parcel's wheels slip."""
        if not grip.slips:
            self._slipping.discard(name)
        elif name not in self._slipping:
            self._slipping.add(name)
            self._notices.append(
                f"wheels slip under {name}: they push with {100 * grip.share:.0f} % of the plan, "
                "and slowly with more again"
            )

    def _drive(self, beliefs: Mapping[str, Belief], step_s: float) -> Iterator[tuple[str, Carried]]:
        """How each parcel that is under way is carried."""
        for name, ride, belief, limit_m in self._under_way(beliefs):
            moves = [move for move in belief.feel if self._where.has_room(name, move)]
            carried = ride.step(belief, step_s, limit_m, moves)
            self._report_slip(name, ride.grip)
            if carried is not None:
                yield name, carried
