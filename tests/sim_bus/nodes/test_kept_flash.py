"""What cells store outlives their table: the next one starts with it."""

from contextlib import ExitStack, closing

import pytest
from tests.sim_bus.nodes.bench import BOOT_TICKS, CELLS, Bench

from mdms_model.errors import InputError
from mdms_protocol.codecs import cob, sdo
from mdms_sim.nodes.kept_flash import KeptFlash
from mdms_sim.nodes.virtual_board import VirtualFlash
from mdms_sim.simulation import open_bank

#: The heartbeat's period [ms], which a cell stores, and the order to store (CiA 301).
PERIOD, STORE = 0x1017, 0x1010
SAVE = b"save"


@pytest.fixture
def bench_of():
    with ExitStack() as opened:

        def bench_of(kept, nodes="cpython"):
            bank = opened.enter_context(closing(open_bank(nodes, CELLS, kept.flash)))
            bench = Bench(bank)
            bench.tick(BOOT_TICKS)
            return bench

        yield bench_of


def ask(bench, data):
    """The answer of the second cell to a request."""
    bench.heard.clear()
    bench.tell(cob.SDO_REQUEST_BASE + 2, data, 1)
    bench.tick(50)
    answers = [each[1] for each in bench.heard if isinstance(each, tuple)]
    (answer,) = [each.data for each in answers if each.can_id == cob.SDO_RESPONSE_BASE + 2]
    return answer


def period_ms(bench):
    return int.from_bytes(ask(bench, sdo.read_request(PERIOD, 0))[4:6], "little")


def test_next_table_starts_with_what_the_cells_have_stored(tmp_path, bench_of):
    path = tmp_path / "state" / "cells.json"
    kept = KeptFlash(path, CELLS)
    bench = bench_of(kept)
    usual_ms = period_ms(bench)
    ask(bench, sdo.write_request(PERIOD, 0, (234).to_bytes(2, "little")))
    assert not kept.keep(), "a setting that is not stored ends with the cell"
    assert not path.exists()
    ask(bench, sdo.write_request(STORE, 1, SAVE))
    assert kept.keep()
    assert not kept.keep()
    again = bench_of(KeptFlash(path, CELLS))
    assert usual_ms != 234
    assert period_ms(again) == 234
    assert period_ms(bench_of(KeptFlash(tmp_path / "other.json", CELLS))) == usual_ms


def test_cells_as_processes_store_for_the_next_table_of_either_kind(tmp_path, bench_of):
    path = tmp_path / "cells.json"
    kept = KeptFlash(path, CELLS)
    bench = bench_of(kept, "micropython")
    ask(bench, sdo.write_request(PERIOD, 0, (234).to_bytes(2, "little")))
    ask(bench, sdo.write_request(STORE, 1, SAVE))
    bench.tick(1100)
    assert kept.keep(), "it is there a second later"
    ask(bench, sdo.write_request(PERIOD, 0, (345).to_bytes(2, "little")))
    ask(bench, sdo.write_request(STORE, 1, SAVE))
    bench.bank.close()
    assert kept.keep(), "what was stored last comes with the end"
    for nodes in ("cpython", "micropython"):
        assert period_ms(bench_of(KeptFlash(path, CELLS), nodes)) == 345


def test_flash_is_the_same_once_saved_and_loaded(tmp_path):
    flash, again = VirtualFlash(), VirtualFlash()
    flash.write(1, 0, b"settings")
    file = flash.files.create("slot")
    before = flash.changes
    file.write(bytes(range(256)))
    file.close()
    assert flash.changes > before
    with (tmp_path / "flash").open("w+b") as saved:
        flash.save(saved)
        saved.seek(0)
        again.load(saved)
    assert again.content() == flash.content()


def test_files_of_firmware_are_kept(tmp_path):
    kept = KeptFlash(tmp_path / "cells.json", 1)
    kept.flash[0].files.replace("slot", bytes(range(256)))
    assert kept.keep()
    assert KeptFlash(kept.path, 1).flash[0].files.read("slot") == bytes(range(256))


def test_state_of_another_table_is_refused_by_name(tmp_path):
    kept = KeptFlash(tmp_path / "cells.json", 2)
    kept.flash[0].write(0, 0, b"settings")
    kept.keep()
    with pytest.raises(InputError, match=r"cells\.json: has the settings of 2 cells, but this"):
        KeptFlash(kept.path, 3)


@pytest.mark.parametrize(
    "text",
    [
        *("", "{}", "[]", '{"form": 2, "cells": []}', '{"form": 1, "cells": [{"banks": ["?"]}]}'),
        pytest.param("[" * 100_000, id="deep"),
    ],
)
def test_file_that_is_no_state_is_refused_by_name(tmp_path, text):
    path = tmp_path / "cells.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"cells\.json: has no stored settings of cells"):
        KeptFlash(path, 2)
