from datetime import UTC, datetime
from hashlib import sha256
from io import BytesIO

from can.io.canutils import CanutilsLogReader

from mdms_model.run.folder import INTERFACE, START_S
from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.identifier import EXTENDED, REMOTE
from mdms_sim.bus.log import BusLog

FRAMES = [
    (Frame(0x181, b"\x00\x11\xab"), 1_234_567),
    (Frame(0x80, b""), 60_000_000_000),
    (Frame(0x18FF00AA | EXTENDED, b"\x01"), 60_000_100_000),
    (Frame(0x123 | REMOTE, bytes(4)), 60_000_200_000),
]
TEXT = b"""(946684800.001234) mdms 181#0011AB
(946684860.000000) mdms 080#
(946684860.000100) mdms 18FF00AA#01
(946684860.000200) mdms 123#R4
"""
FROM_ZERO = b"""(0.001234) mdms 181#0011AB
(60.000000) mdms 080#
(60.000100) mdms 18FF00AA#01
(60.000200) mdms 123#R4
"""


def test_lines_are_those_of_candump_and_the_digest_is_of_lines_from_time_zero():
    file = BytesIO()
    log = BusLog(file)
    for frame, now_ns in FRAMES:
        log.on_frame(INTERFACE, frame, now_ns)
    assert log.log_sha256 == sha256(FROM_ZERO).hexdigest()
    assert file.getvalue() == TEXT


def test_a_long_log_is_written_whole_and_in_order():
    file = BytesIO()
    log = BusLog(file)
    for number in range(1000):
        log.on_frame(INTERFACE, Frame(number, b""), number * 1000)
    log.flush()
    lines = file.getvalue().decode().splitlines()
    assert lines == [f"(946684800.{number:06d}) mdms {number:03X}#" for number in range(1000)]
    digested = file.getvalue().replace(b"(946684800.", b"(0.")
    assert log.log_sha256 == sha256(digested).hexdigest()


def test_log_begins_at_a_date():
    file = BytesIO()
    log = BusLog(file)
    log.on_frame(INTERFACE, Frame(0x80, b""), 0)
    log.flush()
    began = datetime.fromtimestamp(float(file.getvalue()[1:17]), UTC)
    assert began == datetime(2000, 1, 1, tzinfo=UTC)


def test_python_can_reads_the_log_back(tmp_path):
    path = tmp_path / "bus.log"
    path.write_bytes(TEXT)
    with CanutilsLogReader(path) as reader:
        messages = list(reader)
    assert [(m.arbitration_id, m.dlc, bytes(m.data), m.is_extended_id) for m in messages] == [
        (0x181, 3, b"\x00\x11\xab", False),
        (0x80, 0, b"", False),
        (0x18FF00AA, 1, b"\x01", True),
        (0x123, 4, b"", False),
    ]
    assert messages[3].is_remote_frame
    assert [round((m.timestamp - START_S) * 1e6) for m in messages] == [
        1234,
        60_000_000,
        60_000_100,
        60_000_200,
    ]
