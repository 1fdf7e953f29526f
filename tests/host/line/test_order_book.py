"""The order book: once by its key, on the disk before it is said, in doubt after a kill."""

import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tests.host.line.played_table import full_disk

from mdms_host.line import order_book
from mdms_host.line.order_book import OrderBook, OrderBookError
from mdms_host.programs.table_orders import LineOrder, OrderState

ORDER = LineOrder("o1", "P-1", "east", priority=3)


def test_an_order_is_accepted_once_and_gets_the_same_answer_again(tmp_path: Path) -> None:
    with OrderBook(tmp_path / "book") as book:
        assert book.accept(ORDER) == (OrderState.ACCEPTED, True)
        assert book.accept(ORDER) == (OrderState.ACCEPTED, False)
        book.on_event("o1", "under way")
        book.on_event("o1", "left")
        # A closed order stays closed.
        book.on_event("o1", "under way")
        assert book.accept(ORDER) == (OrderState.LEFT, False)
    with OrderBook(tmp_path / "book") as book:
        assert book.accept(ORDER) == (OrderState.LEFT, False)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (b"P-1", b"P-\xff"),
        (b"accepted", b"acbepted"),
        (b'["x"]', b'["x"}'),
        (b"\r\0\0\0", b"\3\0\0\0"),
    ],
)
def test_a_book_that_the_disk_has_spoilt_is_refused_at_once(
    tmp_path: Path, before: bytes, after: bytes
) -> None:
    path = tmp_path / "book"
    with OrderBook(path) as book:
        book.accept(ORDER)
        book.keep("recipe", ["x"])
    whole = path.read_bytes()
    assert before in whole
    path.write_bytes(whole.replace(before, after))
    with pytest.raises(OrderBookError, match="move the file away"):
        OrderBook(path)


@pytest.mark.parametrize("left", [0, 1, 4096])
def test_a_book_that_was_cut_off_is_no_new_one(tmp_path: Path, left: int) -> None:
    with OrderBook(tmp_path / "book") as book:
        book.accept(ORDER)
    os.truncate(tmp_path / "book", left)
    with pytest.raises(OrderBookError, match="move the file away"):
        OrderBook(tmp_path / "book")


def test_another_order_of_the_same_key_is_refused(tmp_path: Path) -> None:
    with OrderBook(tmp_path / "book") as book:
        book.accept(ORDER)
        with pytest.raises(OrderBookError, match="o1 is for P-1 to east already; choose another"):
            book.accept(LineOrder("o1", "P-2", "east"))


def test_orders_without_a_key_or_with_two_goals_are_refused(tmp_path: Path) -> None:
    with OrderBook(tmp_path / "book") as book:
        for order in (
            LineOrder("", "P", "east"),
            LineOrder("k", "P"),
            LineOrder("k", "P", "e", 0, 0),
            LineOrder("k", "P", x_m=float("nan"), y_m=0.0),
            LineOrder("k", "P", x_m=0.0, y_m=float("inf")),
            LineOrder("k", "P", x_m=0.0, y_m=0.0, yaw_rad=float("nan")),
        ):
            with pytest.raises(OrderBookError):
                book.accept(order)


def test_a_clock_that_is_set_repeats_no_order_and_changes_no_sequence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A host without a clock of its own begins in 1970, until its network has told the time."""
    unix_s = [100.0]
    monkeypatch.setattr(order_book, "time", lambda: unix_s[0])
    with OrderBook(tmp_path / "book") as book:
        book.accept(ORDER)
        book.on_event("o1", "left")
    unix_s[0] = 1.8e9
    with OrderBook(tmp_path / "book") as book:
        assert book.accept(ORDER) == (OrderState.LEFT, False)
        book.accept(LineOrder("first", "P-2", "east"))
        unix_s[0] -= 5.0
        book.accept(LineOrder("second", "P-2", "north"))
    with OrderBook(tmp_path / "book") as book:
        waiting = [order.key for order in book.in_state(OrderState.ACCEPTED)]
    assert waiting == ["first", "second"]


def test_old_orders_are_forgotten_behind_many_newer_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    unix_s = [1.7e9]
    monkeypatch.setattr(order_book, "time", lambda: unix_s[0])
    monkeypatch.setattr(order_book, "KEPT", 3)
    with OrderBook(tmp_path / "book") as book:
        for number in range(5):
            book.accept(LineOrder(f"o{number}", "P-1", "east"))
            book.on_event(f"o{number}", "left")
    unix_s[0] += order_book.KEPT_S - 1.0
    with OrderBook(tmp_path / "book") as book:
        assert book.counts() == {OrderState.LEFT: 5}
    unix_s[0] += 2.0
    with OrderBook(tmp_path / "book") as book:
        assert [book.state(f"o{number}") is None for number in range(5)] == [True] * 2 + [False] * 3


def test_a_book_that_stays_open_forgets_old_orders_behind_many_newer_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    unix_s = [1.7e9]
    monkeypatch.setattr(order_book, "time", lambda: unix_s[0])
    monkeypatch.setattr(order_book, "KEPT", 6)
    monkeypatch.setattr(order_book, "FORGETS_EVERY", 4)
    with OrderBook(tmp_path / "book") as book:
        book.accept(LineOrder("open", "P-1", "east"))
        for number in range(7):
            book.accept(LineOrder(f"o{number}", "P-1", "east"))
            book.on_event(f"o{number}", "left")
        unix_s[0] += order_book.KEPT_S + 1.0
        for number in range(7, 11):
            book.accept(LineOrder(f"o{number}", "P-1", "east"))
        assert [book.state(f"o{number}") is None for number in range(7)] == [True] * 5 + [False] * 2
        assert book.counts() == {OrderState.ACCEPTED: 5, OrderState.LEFT: 2}


def test_closed_orders_do_not_make_the_count_of_those_in_doubt_longer(tmp_path: Path) -> None:
    steps: list[int] = []
    with OrderBook(tmp_path / "book") as book:
        book._connection.set_progress_handler(lambda: steps.append(1), 1)

        def steps_of_a_count() -> int:
            steps.clear()
            assert book.count(OrderState.IN_DOUBT) == 1
            return len(steps)

        book.accept(ORDER)
        book.on_event("o1", "in doubt")
        before = steps_of_a_count()
        for number in range(2, 100):
            book.accept(LineOrder(f"o{number}", "P-1", "east"))
            book.on_event(f"o{number}", "left")
        # At 3 steps and more for each order there would be hundreds.
        assert steps_of_a_count() < before + 30


def test_orders_under_way_are_in_doubt_after_the_host_has_ended(tmp_path: Path) -> None:
    with OrderBook(tmp_path / "book") as book:
        book.accept(ORDER)
        book.accept(LineOrder("o2", "P-2", None, 0.1, 0.0))
        book.on_event("o1", "under way")
    with OrderBook(tmp_path / "book") as book:
        assert [order.key for order in book.in_state(OrderState.IN_DOUBT)] == ["o1"]
        assert [order.key for order in book.in_state(OrderState.ACCEPTED)] == ["o2"]
        book.on_event("o1", "arrived")
        assert book.state("o1") == OrderState.ARRIVED


def test_an_order_that_cannot_be_written_is_not_accepted(tmp_path: Path) -> None:
    with OrderBook(tmp_path / "book") as book:
        with full_disk(), pytest.raises(OrderBookError, match=r"o1 cannot be kept: .*make room"):
            book.accept(ORDER)
        assert book.state("o1") is None
        assert book.accept(ORDER) == (OrderState.ACCEPTED, True)


def test_changes_that_cannot_be_written_hold_and_are_written_later(tmp_path: Path) -> None:
    with OrderBook(tmp_path / "book") as book:
        book.accept(ORDER)
        book.accept(LineOrder("o2", "P-2", "east"))
        with full_disk():
            book.on_event("o1", "under way")
            book.on_event("o1", "left", "by east")
            book.on_event("o1", "under way")
            book.keep("recipe", "gentle")
            assert book.trouble is not None
            assert (book.state("o1"), book.kept("recipe")) == (OrderState.LEFT, "gentle")
            row = book.row("o1")
            assert row is not None
            assert (row["state"], row["text"]) == ("left", "by east")
            assert book.count(OrderState.LEFT) == book.count(OrderState.ACCEPTED) == 1
            assert book.count(OrderState.UNDER_WAY) == book.count(OrderState.IN_DOUBT) == 0
        book.keep("other", 1)
        assert book.trouble is None
    with OrderBook(tmp_path / "book") as book:
        assert (book.state("o1"), book.kept("recipe")) == (OrderState.LEFT, "gentle")


def test_a_book_that_is_moved_away_takes_no_order_until_it_is_back(tmp_path: Path) -> None:
    with OrderBook(tmp_path / "state" / "book") as book:
        (tmp_path / "state").rename(tmp_path / "moved")
        with pytest.raises(OrderBookError, match="was moved or removed; put it back"):
            book.accept(ORDER)
        book.keep("recipe", "gentle")
        assert "was moved or removed" in (book.trouble or "")
        (tmp_path / "moved").rename(tmp_path / "state")
        assert book.accept(ORDER) == (OrderState.ACCEPTED, True)
        book.keep("mode", 1)
        assert book.trouble is None
    with OrderBook(tmp_path / "state" / "book") as book:
        assert book.kept("recipe") == "gentle"


def test_a_file_that_is_no_book_or_is_open_elsewhere_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text").write_text("no database, but long enough to be looked at" * 30)
    with pytest.raises(OrderBookError, match="--state"):
        OrderBook(tmp_path / "text")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OrderBookError, match=r"folder: unable to open .*--state"):
        OrderBook(tmp_path / "folder")
    with OrderBook(tmp_path / "book"):
        with pytest.raises(OrderBookError, match=r"another mdms .*; end that one, .*--state") as no:
            OrderBook(tmp_path / "book")
        assert "move" not in str(no.value)


_WRITER = """
import sys
from pathlib import Path
from tests.host.line.played_table import full_disk

from mdms_host.line.order_book import OrderBook
from mdms_host.programs.table_orders import LineOrder
with OrderBook(Path(sys.argv[1])) as book:
    number = int(sys.argv[2])
    while True:
        key = f"o{number}"
        state, new = book.accept(LineOrder(key, key, "east"))
        print(key, int(new), flush=True)
        book.on_event(key, "under way")
        number += 1
"""


def test_no_order_is_lost_or_new_twice_by_kills(tmp_path: Path) -> None:
    """What was acknowledged is there after each kill. `KILLS=1000` in the environment for more."""
    path, acknowledged, new, choose = tmp_path / "book", set(), [], random.Random(1)
    for _ in range(int(os.environ.get("KILLS", "5"))):
        first = str(max(0, len(acknowledged) - 3))
        command = [sys.executable, "-c", _WRITER, str(path), first]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as writer:
            assert writer.stdout is not None
            for _ in range(choose.randint(1, 20)):
                line = writer.stdout.readline()
                assert line
                _note(line, acknowledged, new)
            writer.send_signal(signal.SIGKILL)
            for line in writer.stdout:
                if line.endswith("\n"):
                    _note(line, acknowledged, new)
        with OrderBook(path) as book:
            assert not list(book.in_state(OrderState.UNDER_WAY))
            for key in acknowledged:
                assert book.state(key) in (OrderState.ACCEPTED, OrderState.IN_DOUBT)
    assert len(new) == len(set(new))


def _note(line: str, acknowledged: set[str], new: list[str]) -> None:
    key, is_new = line.split()
    acknowledged.add(key)
    if is_new == "1":
        new.append(key)
