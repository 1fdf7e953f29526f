from mdms_host.flashing.board_survey import BoardInfo, Survey, hashes_of, survey
from mdms_host.flashing.firmware import Firmware

FIRMWARE = Firmware({"main.py": b"1", "cell.mpy": b"M\x06\x1f"}, "abc")


def test_firmware_is_there_only_with_every_file_and_no_other():
    hashes = hashes_of(FIRMWARE)
    assert Survey(hashes, "abc").has(FIRMWARE)
    assert not Survey(hashes | {"cell.py": b""}, "abc").has(FIRMWARE)
    assert not Survey({"main.py": hashes["main.py"]}, "abc").has(FIRMWARE)
    assert not Survey(hashes | {"main.py": b""}, "abc").has(FIRMWARE)
    assert not Survey(hashes, "abc", rom=False).has(FIRMWARE)


def test_machine_code_is_called_as_the_compiler_calls_it():
    def architecture(mpy):
        return BoardInfo("", None, (1, 29, 0), mpy, "00", "/flash", "/flash").architecture

    assert architecture(7 << 10 | 3 << 8 | 6) == "armv7emsp"
    assert architecture(2 << 10 | 3 << 8 | 6) == "x64"
    assert architecture(0 << 10 | 3 << 8 | 6) is None


class Link:
    """A board with these files, as it answers."""

    def __init__(self, *paths):
        self._paths = list(paths)

    def ask(self, question):
        if question.startswith("_files"):
            return self._paths
        return "0.1.0" if question.startswith("_version") else [b""] * (question.count(",") + 1)


def test_firmware_that_came_over_the_bus_is_replaced_and_its_key_and_counter_stay():
    link = Link("update.key", "settings0.bin", "mdms_slots/1", "mdms_slots/record", "main.py")
    assert "mdms_slots/1" in survey(link).hashes
    assert not {*survey(link).hashes} & {"update.key", "settings0.bin", "mdms_slots/record"}
