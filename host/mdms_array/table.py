"""A table for programs without `await`: each call returns when its order is done."""

from collections.abc import Callable, Coroutine, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import wraps
from typing import Any, ParamSpec, Protocol, TypeVar

from mdms_array.run import Run
from mdms_array.source import check_program, check_time
from mdms_host.programs.program import Main
from mdms_host.programs.script import until
from mdms_host.programs.table import Table, TableParcel
from mdms_host.programs.table_parcel import ProgramError
from mdms_model.errors import InputError

Given = ParamSpec("Given")
Result = TypeVar("Result")


class Driver(Protocol):
    """Has a table's time pass: a simulation, or the thread of a real table."""

    @property
    def table(self) -> Table:
        """The table as programs see it."""

    @property
    def is_within(self) -> bool:
        """Whether the caller is a program on the table, for which its time does not pass."""

    def call(
        self,
        routine: Callable[[Table], Coroutine[Any, Any, Result]],
        limit_s: float | None,
    ) -> Result:
        """Run a coroutine to its end, and return its result. Raises its errors, and `RunError`."""

    @property
    def run_so_far(self) -> Run:
        """The run up to now."""


class BlockingTable:
    """A table by hand: `table["box"].move(0.1, 0.0)` returns when the box is there.

    A call that fails raises, and the table goes on. `run` runs a program with coroutines.
    """

    def __init__(self, driver: Driver) -> None:
        self._driver = driver

    def __getitem__(self, name: str) -> "BlockingParcel":
        """The parcel of that name. Raises ProgramError without one."""
        return BlockingParcel(self._driver, self._driver.table[name])

    @property
    def parcels(self) -> tuple["BlockingParcel", ...]:
        """All parcels on the table, in the order of their coming."""
        return tuple(BlockingParcel(self._driver, one) for one in self._driver.table.parcels)

    @property
    def now_s(self) -> float:
        """Time of the table since its program began [s]."""
        return self._driver.table.now_s

    @property
    def run_so_far(self) -> Run:
        """The run up to now."""
        return self._driver.run_so_far

    def run(self, program: Main, limit_s: float | None = None) -> None:
        """Run a program on the table, to its end or for `limit_s` at most.

        Raises the errors of the program, and TimeLimitError.
        """
        check_program(program)
        call(self._driver, program, limit_s)

    def arrival(self, limit_s: float | None = None) -> "BlockingParcel":
        """The next parcel that comes onto the table. Raises ProgramError where none may come."""
        parcel = call(self._driver, lambda table: table.arrival(), limit_s)
        return BlockingParcel(self._driver, parcel)

    def signal(self, name: str, limit_s: float | None = None) -> Any:
        """The next value that has been sent under a name."""
        return call(self._driver, lambda table: table.signal(name), limit_s)

    def send_signal(self, name: str, value: Any = None) -> None:
        """Send a value to the program; see `Table.send_signal`."""
        self._driver.table.send_signal(name, value)

    def sleep(self, seconds: float) -> None:
        """Let so much time of the table pass."""
        seconds = check_time("seconds", seconds)
        call(self._driver, lambda table: table.sleep(seconds), None)


class BlockingParcel:
    """A parcel of a `BlockingTable`."""

    def __init__(self, driver: Driver, parcel: TableParcel) -> None:
        self._driver = driver
        self._parcel = parcel

    def __repr__(self) -> str:
        return repr(self._parcel)

    @property
    def name(self) -> str:
        """Its name."""
        return self._parcel.name

    @property
    def kind(self) -> str:
        """Its kind."""
        return self._parcel.kind

    @property
    def pose(self) -> tuple[float, float, float]:
        """Where it is believed to be: x, y, yaw [m, m, rad; table frame]. Raises ProgramError."""
        return self._parcel.pose

    def move(
        self,
        x_m: float,
        y_m: float,
        yaw_rad: float | None = None,
        limit_s: float | None = None,
    ) -> None:
        """Bring it to a place, turned so if `yaw_rad` is given; returns when it is there.

        Raises ProgramError when it cannot come there, and TimeLimitError, after which it comes to
        rest.
        """
        call(self._driver, lambda _: self._parcel.move(x_m, y_m, yaw_rad), limit_s)

    def leave(self, exit: str | None = None, limit_s: float | None = None) -> None:
        """Have it leave by an exit, or the one for its kind; returns when it has left."""
        call(self._driver, lambda _: self._parcel.leave(exit), limit_s)


def call(
    driver: Driver,
    routine: Callable[[Table], Coroutine[Any, Any, Result]],
    limit_s: float | None,
) -> Result:
    """Have a driver run a coroutine.

    Raises `InputError` for a limit that is no time, and ProgramError within a program of the table.
    """
    if driver.is_within:
        raise ProgramError(
            "another call of this table goes on; in a program await the calls of the table that it "
            "is given, and of several threads let one call at a time"
        )
    return driver.call(routine, None if limit_s is None else check_time("limit_s", limit_s))


class OneBlock(AbstractContextManager[BlockingTable]):
    """A table for one `with` block. Entering it again raises `InputError`."""

    def __init__(self, opened: AbstractContextManager[BlockingTable]) -> None:
        self._opened = opened
        self._was_entered = False

    def __enter__(self) -> BlockingTable:
        if self._was_entered:
            raise InputError("a table is for one `with` block; open another one for the next")
        self._was_entered = True
        return self._opened.__enter__()

    def __exit__(self, *raised: Any) -> bool | None:
        return self._opened.__exit__(*raised)


def for_one_block(
    opens: Callable[Given, Iterator[BlockingTable]],
) -> Callable[Given, OneBlock]:
    """Make a function that yields a table once one that returns it for a `with` block."""

    @wraps(opens)
    def opened(*args: Given.args, **options: Given.kwargs) -> OneBlock:
        return OneBlock(contextmanager(opens)(*args, **options))

    return opened


async def wait_for_ever(_table: Table) -> None:
    """The program of a table by hand: it leaves all to the calls."""
    await until(lambda: False)
