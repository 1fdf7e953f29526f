"""The orders of a plant and the figures of its machine, in a file that survives a kill.

An order is accepted once by its key. Orders that were under way when the host ended are in doubt.
"""

import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing, suppress
from os.path import samestat
from pathlib import Path
from time import time
from typing import Any, Self

from mdms_host.programs.table_orders import CLOSED, LineOrder, OrderState
from mdms_model.errors import Error

#: Raised with every change of the tables below.
VERSION = 1
_SCHEMA = """
CREATE TABLE orders (
  key TEXT PRIMARY KEY, parcel TEXT NOT NULL, exit TEXT, x_m REAL, y_m REAL, yaw_rad REAL,
  priority INTEGER NOT NULL, state TEXT NOT NULL, text TEXT NOT NULL,
  accepted_unix_s REAL NOT NULL, changed_unix_s REAL NOT NULL
);
CREATE INDEX orders_by_state ON orders (state);
CREATE TABLE machine (name TEXT PRIMARY KEY, value TEXT NOT NULL);
"""
_FIELDS = ("key", "parcel", "exit", "x_m", "y_m", "yaw_rad", "priority")
#: Closed orders are kept so long, and answer a client that sends them again [s]. The newest orders
#: are kept in any case: the clock of a host may be wrong by years until its network is there.
KEPT_S = 7 * 86400.0
KEPT = 10_000
#: After so many accepted orders the old ones are looked for again.
FORGETS_EVERY = 1000
#: How an event of a parcel changes its order.
_STATES = {
    "accepted": OrderState.ACCEPTED,
    "under way": OrderState.UNDER_WAY,
    "arrived": OrderState.ARRIVED,
    "left": OrderState.LEFT,
    "refused": OrderState.REFUSED,
    "lost": OrderState.REFUSED,
    "in doubt": OrderState.IN_DOUBT,
}


class OrderBookError(Error):
    """An order that cannot be accepted, or a file that cannot be used."""


class OrderBook:
    """The book in a file; the result of a method is on the disk by then, unless it has a `trouble`.

    An order that cannot be written is not accepted. Other changes hold at once. If one cannot be
    written, it is written with the next one. Raises `OrderBookError` for a file that is none, is of
    another version, or is open elsewhere.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path = path
        #: Why the last changes are not on the disk; None if they are.
        self.trouble: str | None = None
        #: Changes that are not on the disk: state, text and time of orders, and values as JSON.
        self._late_orders: dict[str, tuple[OrderState, str, float]] = {}
        self._late_values: dict[str, str] = {}
        self._accepted = 0
        try:
            if path.is_file() and path.stat().st_size < 2:
                # SQLite takes it for a new book, in which every order would be accepted again.
                raise ValueError("cut off to nothing")
            self._connection = sqlite3.connect(path, isolation_level=None, timeout=1.0)
            try:
                self._open()
                self._opened = path.stat()
            except BaseException:
                self._connection.close()
                raise
        except (sqlite3.DatabaseError, ValueError) as error:
            if getattr(error, "sqlite_errorcode", 0) & 0xFF == sqlite3.SQLITE_BUSY:
                raise OrderBookError(
                    f"{path}: another mdms has this book open; end that one, or choose another "
                    "folder with --state"
                ) from None
            told = error if isinstance(error, sqlite3.DatabaseError) else f"it is spoilt, {error}"
            raise OrderBookError(
                f"{path}: {told}; choose another folder with --state, or move the file away"
            ) from None

    def _open(self) -> None:
        # One process holds the file: two hosts with one book would give every order twice.
        self._connection.execute("PRAGMA locking_mode = EXCLUSIVE")
        self._connection.execute("PRAGMA journal_mode = WAL")
        self._connection.execute("PRAGMA synchronous = FULL")
        (version,) = self._connection.execute("PRAGMA user_version").fetchone()
        if version not in (0, VERSION):
            raise OrderBookError(
                f"{self.path} has version {version}, but this host reads {VERSION}; choose "
                "another folder with --state"
            )
        self._connection.execute("BEGIN IMMEDIATE")
        if version == 0:
            for statement in _SCHEMA.split(";"):
                self._connection.execute(statement)
            self._connection.execute(f"PRAGMA user_version = {VERSION}")
        self._look_through()
        now_s = time()
        self._connection.execute(
            "UPDATE orders SET state = ?, text = ?, changed_unix_s = ? WHERE state = ?",
            (OrderState.IN_DOUBT, "the host ended meanwhile", now_s, OrderState.UNDER_WAY),
        )
        self._forget_old(now_s)
        self._connection.execute("COMMIT")

    def _look_through(self) -> None:
        """Read everything once: a disk may have spoilt it, and no error is to come amid a run."""
        (found,) = self._connection.execute("PRAGMA integrity_check(1)").fetchone()
        if found != "ok":
            raise sqlite3.DatabaseError(found.splitlines()[-1])
        query = f"SELECT {', '.join(_FIELDS)}, text, state FROM orders"
        for *_order, state in self._connection.execute(query):
            OrderState(state)
        for (value,) in self._connection.execute("SELECT value FROM machine"):
            json.loads(value)

    def _check_place(self) -> None:
        """Raises `OrderBookError` if the file is elsewhere by now: a restart would not find it."""
        with suppress(OSError):
            if samestat(self._opened, self.path.stat()):
                return
        raise OrderBookError(f"{self.path} was moved or removed; put it back, or start again")

    def _forget_old(self, now_s: float) -> None:
        closed = ", ".join("?" * len(CLOSED))
        self._connection.execute(
            f"DELETE FROM orders WHERE state IN ({closed}) AND changed_unix_s < ? "
            "AND rowid <= (SELECT MAX(rowid) FROM orders) - ?",
            (*CLOSED, now_s - KEPT_S, KEPT),
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._catch_up()
        self._connection.close()

    def accept(self, order: LineOrder) -> tuple[str, bool]:
        """Accept an order; returns its state, and whether it is new.

        Raises `OrderBookError` if another order has its key, it makes no sense, or it cannot be
        written.
        """
        if order.error is not None:
            raise OrderBookError(order.error)
        before = self._order(order.key)
        if before is not None:
            if before != order:
                raise OrderBookError(
                    f"order {order.key} is for {before.parcel} to "
                    f"{before.exit or (before.x_m, before.y_m)} already; choose another key"
                )
            return str(self.state(order.key)), False
        self._check_place()
        now_s = time()
        values = [getattr(order, name) for name in _FIELDS]
        try:
            self._connection.execute(
                f"INSERT INTO orders VALUES ({', '.join('?' * 11)})",
                (*values, OrderState.ACCEPTED, "", now_s, now_s),
            )
        except sqlite3.DatabaseError as error:
            raise OrderBookError(
                f"order {order.key} cannot be kept: {error}; make room on the disk of --state"
            ) from None
        self._accepted += 1
        if self._accepted % FORGETS_EVERY == 0:
            # On a full disk the next time: this order is accepted.
            with suppress(sqlite3.DatabaseError):
                self._forget_old(now_s)
        return OrderState.ACCEPTED, True

    def change(self, key: str, state: OrderState, text: str = "") -> None:
        """An order has another state; a closed one stays as it is."""
        before = self.state(key)
        if before is not None and before not in CLOSED:
            self._late_orders[key] = (state, text, time())
            self._catch_up()

    def _catch_up(self) -> None:
        """Write the changes that are late."""
        try:
            self._check_place()
            for key, values in list(self._late_orders.items()):
                self._connection.execute(
                    "UPDATE orders SET state = ?, text = ?, changed_unix_s = ? WHERE key = ?",
                    (*values, key),
                )
                del self._late_orders[key]
            for name, value in list(self._late_values.items()):
                self._connection.execute(
                    "INSERT OR REPLACE INTO machine VALUES (?, ?)", (name, value)
                )
                del self._late_values[name]
        except sqlite3.DatabaseError as error:
            self.trouble = f"{self.path}: {error}"
        except OrderBookError as error:
            self.trouble = str(error)
        else:
            self.trouble = None

    def on_event(self, key: str, event: str, text: str = "") -> None:
        """Something has happened to the parcel of an order."""
        state = _STATES.get(event)
        if key and state is not None:
            self.change(key, state, text or event)

    def state(self, key: str) -> str | None:
        """The state of an order; None without one of that key."""
        if key in self._late_orders:
            return str(self._late_orders[key][0])
        return self._written_state(key)

    def _written_state(self, key: str) -> str | None:
        query = "SELECT state FROM orders WHERE key = ?"
        row = self._connection.execute(query, (key,)).fetchone()
        return None if row is None else str(row[0])

    def row(self, key: str) -> dict[str, Any] | None:
        """Everything about an order; None without one of that key."""
        with closing(
            self._connection.execute("SELECT * FROM orders WHERE key = ?", (key,))
        ) as found:
            row = found.fetchone()
            names = [each[0] for each in found.description]
        if row is None:
            return None
        late = self._late_orders.get(key, ())
        changes = dict(zip(("state", "text", "changed_unix_s"), late, strict=False))
        return dict(zip(names, row, strict=True)) | changes

    def in_state(self, state: OrderState) -> Iterator[LineOrder]:
        """All orders in a state, in the order of their acceptance, as the disk has them."""
        query = f"SELECT {', '.join(_FIELDS)} FROM orders WHERE state = ? ORDER BY rowid"
        for row in self._connection.execute(query, (state,)).fetchall():
            yield LineOrder(*row)

    def count(self, state: OrderState) -> int:
        """How many orders are in a state; no other orders are looked at."""
        query = "SELECT COUNT(*) FROM orders WHERE state = ?"
        (count,) = self._connection.execute(query, (state,)).fetchone()
        for key, (late, _text, _unix_s) in self._late_orders.items():
            count += (late == state) - (self._written_state(key) == state)
        return int(count)

    def counts(self) -> dict[str, int]:
        """How many orders are in each state that any is in; every order is looked at."""
        return {state: count for state in OrderState if (count := self.count(state))}

    def _order(self, key: str) -> LineOrder | None:
        query = f"SELECT {', '.join(_FIELDS)} FROM orders WHERE key = ?"
        row = self._connection.execute(query, (key,)).fetchone()
        return None if row is None else LineOrder(*row)

    def keep(self, name: str, value: Any) -> None:
        """Keep a value of the machine."""
        self._late_values[name] = json.dumps(value)
        self._catch_up()

    def kept(self, name: str) -> Any:
        """A value that was kept; None without one."""
        if name in self._late_values:
            return json.loads(self._late_values[name])
        query = "SELECT value FROM machine WHERE name = ?"
        row = self._connection.execute(query, (name,)).fetchone()
        return None if row is None else json.loads(row[0])
