"""One parcel under way by cells that steer: its route, sent to them leg by leg as goals."""

from collections.abc import Callable, Iterator, Sequence

from mdms_host.estimation.belief import Belief
from mdms_host.estimation.footprint import Disc
from mdms_host.motion.by_cells.stages import Followed
from mdms_host.motion.goal import Goal
from mdms_host.motion.trajectory.path import Path
from mdms_host.programs.order import Order
from mdms_host.programs.traffic.ride import Load
from mdms_host.routes.route import Route
from mdms_model.arrays import Floats
from mdms_protocol.neighbours.frames import LEGS_MAX

#: A parcel is at a corner of its route, from where the next leg begins, within this [m].
_CORNER_M = 0.008
#: A leg is sent in parts as the way becomes free, if a part is so much longer than the last [m].
_PART_M = 0.05
#: A parcel that is farther beside its route has left it [m].
_OFF_PATH_M = 0.03
#: How far back and ahead of where it was a parcel is looked for on its route [m].
_SEARCH_M = 0.1
#: Path coordinates that differ by less are the same [m].
_SAME_M = 0.002
#: It stands once it has been slower for so long [m/s; s].
_STILL_M_S = 0.004
_STILL_S = 0.25

#: Has the cells take a parcel to a goal, and, should the host be gone by then, along the legs that
#: follow; returns the follower to the goal.
Send = Callable[[Goal, Sequence[Goal]], Followed]


class Legs:
    """Takes a parcel along a route for an order; see `riding.Riding`. `step` once a cycle.

    A leg is straight, and ends at a corner, amid a half turn, or where the way is not free yet.
    Cells drive straight at the place that was sent last, with `acceleration_m_s2`. If it `goes_on`
    without the host, the legs that follow are sent for that time. They are not sent if the parcel
    is to stop or something is in its way.
    """

    def __init__(
        self,
        order: Order,
        route: Route,
        load: Load,
        send: Send,
        acceleration_m_s2: float,
        *,
        goes_on: bool = False,
    ) -> None:
        self.order = order
        self.route = route
        self.stopping = False
        self.obstructed = False
        self.off_path = False
        self.progress_m = 0.0
        self._is_round = isinstance(load.bottom, Disc)
        self._path = Path(route.poses, load.bottom.reach_m)
        self._send = send
        self._acceleration_m_s2 = acceleration_m_s2
        self._goes_on = goes_on
        self._sent_m = 0.0
        self._leads_on = False
        self._passed_m = 0.0
        self._followed: Followed | None = None
        self._still_s = 0.0

    @property
    def at_rest(self) -> bool:
        """Whether it has stood for a while."""
        return self._still_s >= _STILL_S

    @property
    def stands(self) -> bool:
        """Whether it did not move as its cells commanded, and was stopped."""
        return self._followed is not None and self._followed.stopped

    @property
    def has_come(self) -> bool:
        """Whether nothing but its goal is left to be sent, and it is about to be there."""
        end_m = self._path.length_m
        sent = self._followed is not None and self._sent_m >= end_m
        return sent and self.progress_m >= end_m - _CORNER_M

    @property
    def given_m(self) -> float:
        """Up to where its cells would take it, were the host gone."""
        if not self._leads_on:
            return self._sent_m
        ends_m = [end_m for end_m in self._path.legs_m if end_m > self._sent_m + _SAME_M]
        return max(ends_m[:LEGS_MAX], default=self._sent_m)

    @property
    def arrived(self) -> bool:
        """Whether its cells report it at its goal, and it is believed there."""
        return self.has_come and self._followed is not None and self._followed.arrived

    def has_left(self, belief: Belief | None, last: Floats) -> bool:
        """Never: cells keep parcels on the table."""
        return False

    def step(self, belief: Belief, step_s: float, limit_m: float) -> None:
        """Take in where the parcel is, and send the goal that follows, if another does.

        The way is free up to `limit_m`.
        """
        self._look(belief, step_s)
        if not self.stands:
            self._go(self._to_m(belief, limit_m))

    def _look(self, belief: Belief, step_s: float) -> None:
        """Find the parcel on its route; a corner that it has come to is behind it."""
        path = self._path
        if self._followed is not None and self._followed.overtaken:
            # Without a host for a moment, its cells have gone on to the next corner by themselves.
            self._followed.overtaken = False
            self._passed_m, self._sent_m = self._sent_m, self._corner_after_m(self._sent_m)
            self._leads_on = self._may_lead_on(self._sent_m)
        low_m = max(self._passed_m, self.progress_m - _SEARCH_M)
        nearest_m = path.nearest_m(belief.pose, low_m, self._sent_m)
        off_m = path.distance_m(path.off(belief.pose, nearest_m))
        self.off_path = off_m > _OFF_PATH_M
        there = self._followed is not None and self._followed.arrived
        if there or nearest_m - off_m >= self._sent_m - _CORNER_M:
            self._passed_m = self._sent_m
        self.progress_m = max(self._passed_m, nearest_m - off_m)
        slow = path.distance_m(belief.twist) < _STILL_M_S
        self._still_s = self._still_s + step_s if slow else 0.0

    def _to_m(self, belief: Belief, limit_m: float) -> float:
        """Up to where the cells are to take it now, and no less than where it can stop."""
        path = self._path
        speed_m_s = path.distance_m(belief.twist)
        stop_m = self.progress_m + speed_m_s**2 / (2 * self._acceleration_m_s2)
        if self.stopping or self.off_path:
            return min(self._sent_m, stop_m)
        corner_m = self._corner_after_m(self._passed_m)
        # A way that is free has the same length as the path, but for rounding.
        free_m = corner_m if limit_m > corner_m - _SAME_M else limit_m
        return max(free_m, min(self._sent_m, stop_m))

    def _corner_after_m(self, along_m: float) -> float:
        ahead = (end_m for end_m in self._path.legs_m if end_m > along_m)
        return next(ahead, self._path.length_m)

    def _go(self, to_m: float) -> None:
        """Send a goal, if it is worth the frames; or the same once more if legs may not follow."""
        farther_m = to_m - self._sent_m
        ends = to_m in self._path.legs_m or self._passed_m >= self._sent_m
        same = -_SAME_M <= farther_m <= (_SAME_M if ends else _PART_M)
        leads_on = self._may_lead_on(self._sent_m if same else to_m)
        if same and self._followed is None and to_m < self._path.length_m:
            return
        if same and self._followed is not None and leads_on == self._leads_on:
            return
        if not same:
            self._sent_m = to_m
        self._leads_on = leads_on
        legs = [*self._legs_after(self._sent_m)] if leads_on else []
        self._followed = self._send(self._goal_at(self._sent_m), legs)

    def _may_lead_on(self, sent_m: float) -> bool:
        """Whether cells without a host are to go on after a goal."""
        clear = not (self.stopping or self.off_path or self.obstructed)
        return self._goes_on and clear and sent_m < self._path.length_m - _SAME_M

    def _legs_after(self, sent_m: float) -> Iterator[Goal]:
        """The corners behind a goal, and the end."""
        return (self._goal_at(end_m) for end_m in self._path.legs_m if end_m > sent_m + _SAME_M)

    def _goal_at(self, to_m: float) -> Goal:
        goal = self.order.goal
        if to_m >= self._path.length_m and isinstance(goal, Goal):
            return goal
        x_m, y_m, yaw_rad = self._path.pose_at(to_m).tolist()
        return Goal(x_m, y_m, None if self._is_round else yaw_rad)
