from hypothesis import given
from hypothesis import strategies as st

from mdms_host.flashing.board_survey import Survey, hashes_of
from mdms_host.flashing.firmware import START, Firmware
from mdms_host.flashing.flashing import Plan, plan_flash

paths = st.sampled_from(["cell.mpy", "boards/a.mpy", "boards/b.mpy", "mdms_cell/c.mpy"])
contents = st.dictionaries(paths, st.sampled_from([b"1", b"2"]))


@given(contents, contents, st.booleans(), st.booleans())
def test_whatever_is_there_main_comes_last_and_all_is_right_in_the_end(
    before, wanted, started, force
):
    there = before | ({START: b"old"} if started else {})
    firmware = Firmware({START: b"new", **wanted}, "v")
    found = Survey(hashes_of(Firmware(there, "")), None)
    plan = plan_flash(found, firmware, force=force)
    assert plan.written[-1] == START
    assert plan.size == sum(len(firmware.files[path]) for path in plan.written)
    after = {path: data for path, data in there.items() if path not in plan.stale}
    after |= {path: firmware.files[path] for path in plan.written}
    assert after == firmware.files
    if force:
        assert set(plan.written) == set(firmware.files)


def test_nothing_is_written_where_nothing_differs():
    firmware = Firmware({START: b"new", "cell.mpy": b"1"}, "v")
    assert plan_flash(Survey(hashes_of(firmware), "v"), firmware) == Plan()


def test_image_is_written_only_where_another_is():
    firmware = Firmware({START: b"new"}, "v", rom=b"image")
    hashes = hashes_of(firmware)
    assert plan_flash(Survey(hashes, "v", rom=True), firmware) == Plan()
    assert plan_flash(Survey(hashes, "v", rom=False), firmware).rom == b"image"
    assert plan_flash(Survey({}, None, rom=True), firmware).rom is None
    assert plan_flash(Survey(hashes, "v", rom=True), firmware, force=True).rom == b"image"
