"""200 orders on a simulated `sort54` in real time, by clients of other makers; with all troubles.

`python -m tests.benchmarks line_clients` takes some six minutes; MDMS_ORDERS sets another number.
The table is simulated here, and `mdms run` with both servers is its host. node-opcua commands the
machine. It and modbus-serial announce parcels and give orders in turns. A chute fills up, a parcel
is taken off the conveyor, the network is pulled, the host is killed, and the emergency stop is
pressed. Before that each client gives a burst of orders.

The conveyor and the person are this program: it knows which parcel is which, and counts as a plant
does. After a stop the person puts the parcels of the table back before the scanner, but for the one
at the infeed. That one has no identity any more. In the end the order of each parcel must have the
state that the truth has.
"""

import os
import re
import time
from collections import Counter, deque
from contextlib import ExitStack
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from threading import Timer
from time import perf_counter
from typing import Any

import numpy as np
from tests.system.line.controller import PATIENCE_S, admit_user
from tests.system.line.node_client import ClientError, Network, NodeClient, check_is_there
from tests.system.links.going_away import Plant

from mdms_model.run.record import exit_of
from mdms_model.scenario.fault import Fault
from mdms_sim.physics.plane.handling import take_away
from mdms_sim.simulation import NS_PER_S

ORDERS = int(os.environ.get("MDMS_ORDERS", "200"))
#: So many parcels are announced and ordered ahead of the infeed.
AHEAD = 12
#: Orders of a burst, which are to be acknowledged within so long, and 99 % of them within [s].
BURST, BURST_S, P99_S = 200, 2.0, 0.05
#: Time for an order before this gives up [s].
ORDER_S = 6.0
#: A parcel that has left is reported within this [s].
TOLD_S = 5.0
#: A parcel so near to where it was set down is at the infeed [m].
_INFEED_M = 0.1
FULL_S, PULLED_S = 10.0, 3.0
#: What the host has said, and the states of all orders, of a run that has failed.
LOG = Path("build/line_clients.txt")
#: What the host's own log says of an order that is done.
_LEFT = re.compile(r"order (\S+): \S+ left")


def run() -> list[dict[str, Any]]:
    """One run."""
    check_is_there()
    began_s = perf_counter()
    with TemporaryDirectory() as folder, _Line(Path(folder)) as line:
        bursts = line.bursts()
        line.run()
        return [*bursts, line.row(perf_counter() - began_s)]


class _Line:
    """The plant around a table: its conveyor, its chutes, a person, and two clients."""

    def __init__(self, folder: Path) -> None:
        admit_user(folder)
        self._random = Random(6)
        self._opened = ExitStack()
        open_ = self._opened.enter_context
        self._plant = open_(Plant(folder, "mdms", "--opcua", "0", source="sort54"))
        self._exits = [each.name for each in self._plant.scenario.exit]
        self._networks = open_(Network()), open_(Network())
        url = f"opc.tcp://127.0.0.1:{self._networks[0].port}/mdms/"
        self._opcua, self._modbus = open_(NodeClient("opcua")), open_(NodeClient("modbus"))
        self._where = {
            self._opcua: (url, str(folder / "pki")),
            self._modbus: (str(self._networks[1].port),),
        }
        #: Parcels by their identities: the exit, the key of the order that counts, and all keys.
        self._exit: dict[str, str] = {}
        self._key: dict[str, str] = {}
        self._given: dict[str, str] = {}
        #: Announced parcels before the table, those on it by their names in the simulation, and
        #: what has left, as a plant sees it.
        self._conveyor: deque[str] = deque()
        self._on_table: dict[str, str | None] = {}
        self._left: list[tuple[str, str, float]] = []
        self._unidentified: list[str] = []
        self._untold: dict[str, float] = {}
        self._seen = 0
        self._in_doubt: set[str] = set()
        #: States in which the machine was found, with no trouble to blame.
        self._rests: Counter[str] = Counter()
        self._unseen: set[str] = set()
        self._twice = self._late = self._moved = self._announced_again = self._stranded = 0
        self._lead()
        self._connect()

    def __enter__(self) -> "_Line":
        return self

    def __exit__(self, *_error: object) -> None:
        self._opened.close()

    # The run -------------------------------------------------------------------------------------

    def run(self) -> None:
        """Give all orders, with all troubles."""
        troubles = [self._fill, self._remove, self._pull, self._kill, self._press]
        due = [
            round(ORDERS * (number + 1) / (len(troubles) + 1)) for number in range(len(troubles))
        ]
        end_s = time.monotonic() + ORDERS * ORDER_S + len(troubles) * PATIENCE_S
        self._feed()
        self._to_execute()
        while not self._is_done():
            assert time.monotonic() < end_s, (self._opcua.ask("state"), self._plant.said[-20:])
            if due and len(self._left) >= due[0]:
                due.pop(0)
                troubles.pop(0)()
            self._feed()
            self._tend()
            self._pass(0.1)
        self._opcua.ask("command", "Stop")
        self._until("Stopped")

    def _tend(self) -> None:
        """Bring the machine back where a busy computer has held or suspended it."""
        state = self._opcua.ask("state")
        if state in ("Held", "Suspended"):
            if "no parcel comes" in self._opcua.ask("read", "Reason"):
                # The host has told of parcels as gone that stand before the infeed.
                for name in list(self._on_table):
                    self._stranded += 1
                    self._take_off(name)
            else:
                self._rests[state] += 1
                self._opcua.ask("command", "Unhold" if state == "Held" else "Unsuspend")
        elif state in ("Aborted", "Stopped"):
            self._rests[state] += 1
            if state == "Aborted":
                self._opcua.ask("command", "Clear")
                self._until("Stopped")
            self._resume()

    def bursts(self) -> list[dict[str, Any]]:
        """Orders for parcels that never come, one after the other by each client."""
        names = {self._opcua: "node-opcua", self._modbus: "modbus-serial"}
        return [self._burst(client, name) for client, name in names.items()]

    def _burst(self, client: NodeClient, name: str) -> dict[str, Any]:
        exit = self._exits[0] if client is self._opcua else 1
        keys, took_s = [f"{name[0]}{number}" for number in range(BURST)], []
        began_s = perf_counter()
        for key in keys:
            asked_s = perf_counter()
            assert client.ask("order", key, f"none {key}", exit)
            took_s.append(perf_counter() - asked_s)
        all_s = perf_counter() - began_s
        for key in keys:
            client.ask("cancel", key)
        p99_s = float(np.percentile(took_s, 99))
        return {
            "name": f"{BURST} orders in a burst by {name}: acknowledged in",
            "ours": all_s,
            "unit": "s",
            "goal": BURST_S,
            "p99_ms": 1e3 * p99_s,
            "goal_p99_ms": 1e3 * P99_S,
            "load_average": os.getloadavg()[0],
        }

    def _is_done(self) -> bool:
        return len(self._exit) == ORDERS and not self._conveyor and not self._pending()

    def _pending(self) -> list[str]:
        """Parcels with an order that is to be carried out yet, or to be reported."""
        on_table = [each for each in self._on_table.values() if each in self._key]
        return on_table + list(self._untold)

    def _feed(self) -> None:
        while len(self._exit) < ORDERS and len(self._conveyor) < AHEAD:
            identity = f"P-{len(self._exit)}"
            self._exit[identity] = self._random.choice(self._exits)
            self._scan(identity, f"o{len(self._exit)}")

    def _scan(self, identity: str, key: str) -> None:
        """A parcel comes by the scanner, and has an order of that key."""
        self._client().ask("coming", identity)
        self._conveyor.append(identity)
        self._give(key, identity)

    def _client(self) -> NodeClient:
        return self._opcua if len(self._given) % 2 else self._modbus

    def _give(self, key: str, identity: str) -> None:
        """Give an order, by the clients in turns; it counts as given when that is answered."""
        assert self._ordered(self._client(), key, identity)
        self._given[key] = identity
        self._key[identity] = key

    def _ordered(self, client: NodeClient, key: str, identity: str) -> bool:
        """Whether an order is new."""
        exit = self._exit[identity]
        place = exit if client is self._opcua else self._exits.index(exit) + 1
        return bool(client.ask("order", key, identity, place))

    # What the plant sees -------------------------------------------------------------------------

    def _look(self) -> None:
        """Take in which parcels have come, and which have left."""
        events = self._plant.simulation.world.events
        for event in events[self._seen :]:
            self._seen += 1
            if event.kind == "arrival":
                self._on_table[event.parcel] = self._conveyor.popleft() if self._conveyor else None
            elif event.kind == "exit":
                self._leaves(event.parcel, exit_of(event))

    def _leaves(self, name: str, exit: str) -> None:
        identity = self._on_table.pop(name, None)
        if identity is None:
            return
        self._left.append((identity, exit, time.monotonic()))
        if identity in self._key:
            self._untold[identity] = time.monotonic() + TOLD_S
        else:
            self._unidentified.append(identity)

    def _hear(self) -> None:
        """Ask for the orders of the parcels that have left."""
        for identity, until_s in list(self._untold.items()):
            state = self._modbus.ask("ask", self._key[identity])
            if state == "left":
                del self._untold[identity]
            elif time.monotonic() > until_s:
                del self._untold[identity]
                self._late += 1

    # Troubles ------------------------------------------------------------------------------------

    def _fill(self) -> None:
        """A chute is full: no parcel drops into it, but those that are half in already."""
        self._modbus.ask("full", [1])
        self._pass(2.0)
        before = self._left_by(self._exits[0])
        self._pass(FULL_S)
        self._moved = self._left_by(self._exits[0]) - before
        self._modbus.ask("full", [])

    def _left_by(self, exit: str) -> int:
        return sum(each == exit for _, each, _ in self._left)

    def _pass(self, seconds: float) -> None:
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self._look()
            self._hear()
            time.sleep(0.1)

    def _pull(self) -> None:
        """The network is away, with an order under way in it; the clients come back."""
        for each in self._networks:
            each.pull()
        cut = self._cut(self._opcua)
        time.sleep(PULLED_S)
        for each in self._networks:
            each.plug_in()
        self._connect()
        self._until("Suspended")
        self._again(cut)
        self._announce_again()
        self._pass(1.0)
        self._opcua.ask("command", "Unsuspend")
        self._until("Execute")

    def _kill(self) -> None:
        """The host is killed while orders are given, and begins again."""
        Timer(self._random.uniform(0.0, 0.1), self._plant.host.kill).start()
        cut = None
        while cut is None:
            cut = self._cut(self._modbus)
        self._plant.host.wait()
        self._plant.begin_host_again()
        self._lead()
        self._connect()
        assert self._opcua.ask("state") == "Stopped"
        self._again(cut)
        self._resume()

    def _press(self) -> None:
        """The emergency stop is pressed, and released; then Clear and Reset."""
        faults, supply = self._plant.simulation.faults, Fault("supply", supply_v=0.0)
        pressed: list[Any] = []
        self._plant.at_table(lambda: pressed.append(faults.begin(supply)))
        self._until("Aborted")
        self._pass(2.0)
        self._plant.at_table(lambda: faults.end(pressed[0]))
        self._pass(1.0)
        assert self._opcua.ask("state") == "Aborted"
        self._opcua.ask("command", "Clear")
        self._until("Stopped")
        self._resume()

    def _remove(self) -> None:
        """A person takes a parcel off the conveyor, and puts it back before the scanner."""
        identity = self._conveyor[len(self._conveyor) // 2]
        self._opcua.ask("gone", identity)
        self._conveyor.remove(identity)
        self._modbus.ask("coming", identity)
        self._conveyor.append(identity)

    def _cut(self, client: NodeClient) -> tuple[str, str] | None:
        """Scan one more parcel and give its order; its key, if there was no answer."""
        if len(self._exit) == ORDERS:
            return "", ""
        identity, key = f"P-{len(self._exit)}", f"o{len(self._exit) + 1}"
        self._exit[identity] = self._random.choice(self._exits)
        try:
            client.ask("coming", identity)
            self._conveyor.append(identity)
            assert self._ordered(client, key, identity)
        except ClientError:
            return key, identity
        self._given[key], self._key[identity] = identity, key
        return None

    def _again(self, cut: tuple[str, str] | None) -> None:
        """Send again all that was sent: a client does not know what has arrived."""
        for key, identity in self._given.items():
            self._twice += self._ordered(self._client(), key, identity)
        if cut is None or not cut[0]:
            return
        key, identity = cut
        self._ordered(self._modbus, key, identity)
        self._twice += self._ordered(self._opcua, key, identity)
        self._given[key], self._key[identity] = identity, key
        if identity not in self._conveyor:
            self._conveyor.append(identity)

    def _announce_again(self) -> None:
        """Announce what is before the table, in its order; the host may know it already."""
        for identity in self._conveyor:
            try:
                self._modbus.ask("coming", identity)
            except ClientError as error:
                if not error.refused:
                    raise
            else:
                self._announced_again += 1

    def _resume(self) -> None:
        """After a stop: clear the table but for the infeed, Reset, announce again, and Start."""
        again = self._take_all_off()
        # Where the infeed is free now, the next parcel comes before anybody looks.
        self._pass(0.5)
        again += self._take_all_off()
        self._opcua.ask("command", "Reset")
        self._until("Idle")
        self._announce_again()
        for identity in again:
            self._scan(identity, f"o{len(self._given) + 1}-2")
        self._start()

    def _take_all_off(self) -> list[str]:
        """Give up the orders of all parcels on the table; those that were taken off it."""
        self._look()
        taken = []
        for identity in [*self._on_table.values(), *self._untold]:
            if identity in self._key:
                self._give_up(identity)
        for name, identity in list(self._on_table.items()):
            if not self._is_at_infeed(name):
                self._take_off(name)
                taken += [] if identity is None else [identity]
        return taken

    def _give_up(self, identity: str) -> None:
        """The order for a parcel that is on the table, or has left it unseen, is over."""
        key = self._key.pop(identity)
        state = self._opcua.ask("ask", key)
        if state == "in doubt":
            self._in_doubt.add(key)
        if state in ("accepted", "in doubt"):
            self._opcua.ask("cancel", key)
        if self._untold.pop(identity, None) is not None and state != "left":
            self._unseen.add(identity)

    def _is_at_infeed(self, name: str) -> bool:
        stream = self._plant.scenario.stream[0]
        x_m, y_m, _ = self._plant.simulation.world.pose[self._number(name)]
        return bool(abs(x_m - stream.x_m) < _INFEED_M and abs(y_m - stream.y_m) < _INFEED_M)

    def _number(self, name: str) -> int:
        return [each.name for each in self._plant.scenario.parcel].index(name)

    def _take_off(self, name: str) -> None:
        scene, number = self._plant.simulation.world.scene, self._number(name)
        self._plant.at_table(lambda: take_away(scene, number))
        del self._on_table[name]

    # The machine ---------------------------------------------------------------------------------

    def _lead(self) -> None:
        """The networks lead to the ports of this host; the plant's own client is not needed."""
        self._networks[0].lead_to(int(self._plant.opcua.rpartition(":")[2].partition("/")[0]))
        self._networks[1].lead_to(self._plant.controller.port)
        self._plant.controller.close()

    def _connect(self) -> None:
        end_s = time.monotonic() + PATIENCE_S
        for client, where in self._where.items():
            while True:
                try:
                    client.connect(*where)
                except ClientError:
                    if time.monotonic() > end_s:
                        raise
                    time.sleep(0.5)
                else:
                    break

    def _to_execute(self) -> None:
        self._opcua.ask("command", "Reset")
        self._until("Idle")
        self._start()

    def _start(self) -> None:
        # The heartbeat is taken in with the next snapshot.
        time.sleep(0.5)
        self._opcua.ask("command", "Start")
        self._until("Execute")

    def _until(self, state: str) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while self._opcua.ask("state") != state:
            assert time.monotonic() < end_s, (state, self._plant.said[-20:])
            self._look()
            time.sleep(0.1)

    # The end -------------------------------------------------------------------------------------

    def row(self, took_s: float) -> dict[str, Any]:
        """What came of it, by both clients and the truth."""
        states = {key: self._opcua.ask("ask", key) for key in self._given}
        disagreeing = sum(self._modbus.ask("ask", key) != states[key] for key in states)
        told = Counter(each for key, each in self._given.items() if states[key] == "left")
        true = {identity: exit for identity, exit, _ in self._left}
        left = {each for each in true if each not in (*self._unidentified, *self._unseen)}
        log = Counter(each[1] for line in self._plant.said if (each := _LEFT.search(line)))
        wrong = sum(true.get(each) != self._exit[each] for each in told)
        twice = self._twice + sum(count > 1 for count in (*told.values(), *log.values()))
        repeated = sum(states[key] != "cancelled" for key in self._in_doubt)
        lost = sum(state not in ("left", "cancelled") for state in states.values())
        untold = len(left ^ told.keys())
        faults = (wrong, twice, repeated, lost, untold, disagreeing, self._late, self._moved)
        failed = any(faults) or len(true) != ORDERS
        if failed:
            LOG.parent.mkdir(exist_ok=True)
            LOG.write_text("".join(self._plant.said) + f"{states}\n")
        return {
            "name": f"{ORDERS} orders on sort54 in real time, by node clients: done",
            "ours": len(told),
            "peer": ORDERS,
            "ratio": len(told) / ORDERS,
            "unit": "parcels",
            "failed": failed,
            "wrong_exit": wrong,
            "twice": twice,
            "repeated": repeated,
            "lost": lost,
            "told_refused": sum(state == "refused" for state in states.values()),
            "truth_unlike_told": untold,
            "clients_disagree": disagreeing,
            "told_late": self._late,
            "into_a_full_chute": self._moved,
            "without_identity": len(self._unidentified),
            "unseen": len(self._unseen),
            "in_doubt": len(self._in_doubt),
            "stranded": self._stranded,
            "announced_again": self._announced_again,
            **{name.lower(): count for name, count in self._rests.items()},
            "table_late_s": self._plant.time.late_ns / NS_PER_S,
            "took_s": took_s,
            "load_average": os.getloadavg()[0],
        }
