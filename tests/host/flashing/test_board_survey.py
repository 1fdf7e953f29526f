from mdms_host.flashing.board_survey import BoardInfo, Survey, hashes_of
from mdms_host.flashing.firmware_build import Firmware

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
