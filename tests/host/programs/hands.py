"""Orders that a test carries out itself, and parcels that it puts on the table."""

from collections.abc import Mapping

import numpy as np

from mdms_host.estimation.belief import Belief
from mdms_host.estimation.footprint import Rectangle
from mdms_host.programs.order import Gate
from mdms_host.programs.program import Member, TableProgram
from mdms_host.programs.table import Table

EAST = Gate("east", (0, 1), 0.35, -0.2, 0.2, ("box",))
NORTH = Gate("north", (1, 1), 0.15, -0.3, 0.3, ("disc",))
CYCLE_S = 0.01


class Hands:
    """The traffic of a test: nothing moves but by `arrive`, `leave` and `refuse`."""

    def __init__(self) -> None:
        self.orders = {}
        self.log = []
        self.stopped = False
        self.at_rest = True
        self.known = {}
        self.near = ()
        self.steered: Mapping = {}
        self.plan, self.ways, self.reserved = None, {}, []
        self.under_way, self.due_in_s = [], {}
        self._left = []

    def give(self, order):
        if order.parcel in self.orders:
            self.orders[order.parcel].replaced = True
        self.orders[order.parcel] = order
        goal = order.goal
        self.log.append((order.parcel, goal.name if isinstance(goal, Gate) else goal))

    def cancel(self, order):
        order.replaced = True
        self.orders.pop(order.parcel)

    def forget_refused(self):
        pass

    def stop(self):
        self.stopped = True
        for order in self.orders.values():
            order.replaced = True

    def step(self, beliefs, step_s):
        return np.zeros(36)

    def on_lost_cells(self, cells):
        self.lost_cells = cells

    def withdraw(self, name):
        if name in self.orders:
            self.orders.pop(name).done = True
        self._left.append(name)

    def know(self, parcel, mass):
        self.known[parcel.name] = parcel, mass

    def attend(self, tracked):
        self.tracked = tracked

    def take_leaving(self):
        return []

    def take_left(self):
        left, self._left = self._left, []
        return left

    def take_notices(self):
        return []


class Stage:
    """A program on a table of two gates, driven cycle by cycle."""

    def __init__(self, main, lying=(), coming=()):
        self.hands = Hands()
        members = [Member(name, name.split()[0], 0.3, 0.3) for name in lying]
        members += [Member(name, name.split()[0], 0.3, 0.3, lies=False) for name in coming]
        table = Table((0.57, 0.38), [EAST, NORTH], self.hands)
        self.program = TableProgram(main, table, members, self.hands)
        self.beliefs = {}
        for name in lying:
            self.put(name, round(0.2 * len(self.beliefs) - 0.3, 3))

    @property
    def log(self):
        """The orders since the last look, as parcel and place."""
        log, self.hands.log = self.hands.log, []
        return [(name, goal if isinstance(goal, str) else goal.x_m) for name, goal in log]

    def put(self, name, x_m=-0.3):
        self.beliefs[name] = Belief(
            name, Rectangle(0.3, 0.3), np.array([x_m, 0.0, 0.0]), np.zeros(3), np.zeros((3, 3))
        )

    def run(self, seconds=CYCLE_S):
        for _ in range(round(seconds / CYCLE_S)):
            self.program.references_m_s(self.beliefs, CYCLE_S)

    def come(self, *names):
        for name in names:
            self.put(name)
        self.run()

    def arrive(self, name):
        order = self.hands.orders.pop(name)
        self.put(name, order.goal.x_m)
        order.done = True
        self.run()

    def withdraw(self, name):
        """The parcel was found by mistake."""
        del self.beliefs[name]
        self.hands.orders.pop(name).done = True
        self.program.driver.remove(name, withdrawn=True)
        self.run()

    def leave(self, name):
        self.hands.orders.pop(name).done = True
        del self.beliefs[name]
        self.hands._left.append(name)
        self.run()

    def refuse(self, name, reason):
        self.hands.orders.pop(name).refused = reason
        self.run()
