"""Services of a cell as sequences of frames, in the order in which a client would send them.

A frame is (identifier, data). An identifier below 0 is no frame but an event: PAUSE with
milliseconds, POWER for a new start, or one of those that go on and off.
"""

from mdms_protocol.codecs import cob, lss, nmt, sdo

NODE = 5
SERIAL = 0x1234
HOST = 127

PAUSE = -1
POWER = -2
BUS = -3
CURRENT = -4
MEMORY = -5
ROOM = -6

SERVER = cob.SDO_REQUEST_BASE + NODE
_IDENTITY = (0, 0x4D444D53, 0x00010000, SERIAL)


def _command(command, node=NODE):
    return cob.NMT, bytes((command, node))


def _write(index, sub, number, size):
    return SERVER, sdo.write_request(index, sub, number.to_bytes(size, "little"))


def _read(index, sub):
    return SERVER, sdo.read_request(index, sub)


def _control(*words):
    return [(cob.RPDO_BASES[1] + NODE, bytes((word, 0, word, 0))) for word in words]


def _lss(command, *rest):
    return cob.LSS_REQUEST, bytes((command,)) + bytes(rest) + bytes(7 - len(rest))


def _lss_number(command, number, *rest):
    return _lss(command, *number.to_bytes(4, "little"), *rest)


def head(command, index, sub):
    """The first four bytes of a request."""
    return bytes((command, index & 0xFF, index >> 8, sub))


def _segments(index, sub, value, told):
    """A segmented download."""
    size = len(value) if told else 0
    frames = [(SERVER, head(sdo.DOWNLOAD | told, index, sub) + size.to_bytes(4, "little"))]
    toggle = 0
    for start in range(0, len(value), 7):
        piece = value[start : start + 7]
        unused = 7 - len(piece)
        command = sdo.DOWNLOAD_SEGMENT | toggle | unused << 1 | (start + 7 >= len(value))
        frames.append((SERVER, bytes((command,)) + piece + bytes(unused)))
        toggle ^= sdo.TOGGLE
    return frames


def _blocks(index, sub, value, options):
    """A block download; `options` are those of its first command."""
    command = sdo.BLOCK_DOWNLOAD | options
    frames = [(SERVER, head(command, index, sub) + len(value).to_bytes(4, "little"))]
    for start in range(0, len(value), 7):
        piece = value[start : start + 7]
        sequence = start // 7 % sdo.BLOCK_SEGMENTS + 1
        last = sdo.BLOCK_LAST if start + 7 >= len(value) else 0
        frames.append((SERVER, bytes((sequence | last,)) + piece + bytes(7 - len(piece))))
    crc = sdo.crc16(value, 0)
    end = sdo.BLOCK_DOWNLOAD | -len(value) % 7 << 2 | sdo.BLOCK_END
    frames.append((SERVER, bytes((end, crc & 0xFF, crc >> 8)) + bytes(5)))
    return frames


def _block_upload(index, sub, block_size, segments):
    """A block upload of so many segments, acknowledged as they should come."""
    command = sdo.BLOCK_UPLOAD | sdo.BLOCK_CRC
    frames = [
        (SERVER, head(command, index, sub) + bytes((block_size, 0, 0, 0))),
        (SERVER, bytes((sdo.BLOCK_UPLOAD | sdo.BLOCK_START,)) + bytes(7)),
        (PAUSE, 5),
    ]
    for start in range(0, segments, block_size):
        come = min(block_size, segments - start)
        acknowledge = sdo.BLOCK_UPLOAD | sdo.BLOCK_ACKNOWLEDGE
        frames.append((SERVER, bytes((acknowledge, come, block_size)) + bytes(5)))
        frames.append((PAUSE, 5))
    frames.append((SERVER, bytes((sdo.BLOCK_UPLOAD | sdo.BLOCK_END,)) + bytes(7)))
    return frames


def _fast_scan():
    """Find the cell by three bits of each part of its identity, then give it its node id."""
    frames = [_lss_number(lss.FAST_SCAN, 0, lss.SCAN_ALL, 0, 0)]
    for part in range(4):
        for bit in (31, 9, 0):
            following = (part + 1) % 4 if bit == 0 else part
            frames.append(_lss_number(lss.FAST_SCAN, _IDENTITY[part], bit, part, following))
    return frames


def _remapped(parameters, mapping, can_id, type_, entries):
    """The standard's procedure to change a PDO."""
    frames = [
        _write(parameters, 1, can_id | cob.INVALID, 4),
        _write(parameters, 2, type_, 1),
        _write(mapping, 0, 0, 1),
    ]
    for sub, entry in enumerate(entries, 1):
        frames.append(_write(mapping, sub, entry, 4))
    frames.append(_write(mapping, 0, len(entries), 1))
    frames.append(_write(parameters, 1, can_id, 4))
    return frames


_START = [_command(nmt.START), _control(0x00, 0x80, 0x06, 0x07, 0x0F)]
_TARGETS = (cob.RPDO_BASES[0] + NODE, b"\x0c\xf8\x00\x00\xf4\x07\xff\xff")
_SYNC = (cob.SYNC, b"")
_BOOT = (PAUSE, 60)
_HEARTBEAT = (cob.HEARTBEAT_BASE + HOST, bytes((nmt.OPERATIONAL,)))
_ANOTHER = (cob.HEARTBEAT_BASE + NODE, bytes((nmt.OPERATIONAL,)))
_NEW_ID = [_lss(lss.CONFIGURE_NODE_ID, NODE), _lss(lss.STORE), _lss(lss.SWITCH_GLOBAL, 0), _BOOT]
_NO_ID = [_lss(lss.SWITCH_GLOBAL, 1), _lss(lss.CONFIGURE_NODE_ID, 255), _lss(lss.SWITCH_GLOBAL, 0)]

#: Services in their order; a list among them is as good as its frames.
_SERVICES = (
    [_START, _TARGETS, _SYNC, _TARGETS, _SYNC, _SYNC],
    [_START, _TARGETS, _SYNC, _SYNC, _TARGETS, _SYNC],
    [_START, _TARGETS, _SYNC, (PAUSE, 20), _control(0x02), (PAUSE, 40)],
    [_START, _TARGETS, _SYNC, _control(0x8F), (PAUSE, 80)],
    [_START, _TARGETS, _SYNC, (CURRENT, 1), (PAUSE, 120), (CURRENT, 0)],
    [_START, _write(0x2005, 0, 10, 2), _write(0x2004, 0, 1, 4), _TARGETS, _SYNC, (PAUSE, 30)],
    [_START, _write(0x2007, 0, 10, 2), _write(0x60F8, 0, 1, 4), _TARGETS, _SYNC, (PAUSE, 30)],
    [_write(0x607E, 0, 0x40, 1), _write(0x6083, 0, 99_000, 4), _write(0x6084, 0, 99_000, 4)],
    [_START, _TARGETS, _SYNC, (PAUSE, 30), (cob.RPDO_BASES[0] + NODE, bytes(8)), _SYNC],
    [_write(0x607E, 0, 0, 1), _write(0x6083, 0, 0, 4), _write(0x6084, 0, 0, 4)],
    [_START, (BUS, 1), (PAUSE, 10), (BUS, 0)],
    [_command(nmt.STOP), _read(0x1001, 0), _command(nmt.ENTER_PRE_OPERATIONAL), _SYNC],
    [_command(nmt.RESET_NODE), _BOOT, _command(nmt.START)],
    [_command(nmt.RESET_COMMUNICATION, 0), _BOOT, _command(nmt.START, 0)],
    [_command(nmt.RESET_NODE), (PAUSE, 5), (SERVER, b"\x40\x18\x10\x04\x09\0\0\0"), _BOOT],
    [_command(nmt.RESET_NODE), (PAUSE, 5), _read(0x1018, 4), _BOOT],
    [_command(nmt.RESET_NODE), (PAUSE, 5), _ANOTHER, _BOOT, _command(nmt.RESET_NODE), _BOOT],
    [_START, _ANOTHER, (PAUSE, 10), _command(nmt.RESET_COMMUNICATION), _BOOT],
    [_write(0x1029, 1, 2, 1), _START, (cob.SDO_RESPONSE_BASE + NODE, bytes(8)), (PAUSE, 10)],
    [_write(0x1016, 1, HOST << 16 | 20, 4), _START, _HEARTBEAT, (PAUSE, 40), _HEARTBEAT],
    [_write(0x1016, 2, HOST << 16 | 20, 4), _write(0x1016, 1, HOST << 16 | 20, 4)],
    [_write(0x1016, 1, 0, 4), _write(0x1016, 2, 0, 4), _write(0x1029, 1, 1, 1)],
    [_write(0x1017, 0, 7, 2), (PAUSE, 30), _write(0x1017, 0, 0, 2), (PAUSE, 5)],
    [_write(0x1015, 0, 90, 2), _write(0x1014, 0, 0x85, 4), _ANOTHER, _write(0x1015, 0, 0, 2)],
    [_write(0x1014, 0, 0x80000085, 4), (PAUSE, 5), _write(0x1014, 0, 0x85, 4), (PAUSE, 5)],
    [_write(0x1014, 0, 0x86, 4), _write(0x1014, 0, 0x05, 4), _write(0x1014, 0, 0x85, 4)],
    [_read(0x1003, 0), _read(0x1003, 1), _read(0x1003, 8), _write(0x1003, 0, 0, 1)],
    [_write(0x1005, 0, 0x90, 4), (0x090, b""), _write(0x1005, 0, 0x80, 4), _SYNC],
    [_write(0x1005, 0, 0x40000080, 4), _write(0x1005, 0, 0x05, 4)],
    [_write(0x1401, 5, 20, 2), _START, (PAUSE, 30), _control(0x0F), _write(0x1401, 5, 0, 2)],
    _remapped(0x1802, 0x1A02, 0x385, 254, (0x60610008, 0x30010008, 0x606C0020)),
    _remapped(0x1802, 0x1A02, 0x385, 0, (0x60630020, 0x68630020)),
    _remapped(0x1803, 0x1A03, 0x485, 3, (0x60410010, 0x68410010, 0x60780010, 0x10010008)),
    _remapped(0x1803, 0x1A03, 0x485, 255, (0x60630020, 0x68630020, 0x60410010)),
    _remapped(0x1402, 0x1602, 0x305, 255, (0x60400010, 0x00060010)),
    _remapped(0x1402, 0x1602, 0x305, 255, (0x60600008, 0x68600008)),
    _remapped(0x1402, 0x1602, 0x186, 1, (0x00050008, 0x60400010, 0x60FF0020)),
    _remapped(0x1402, 0x1602, 0x186, 241, (0x00070010, 0x60410010)),
    _remapped(0x1803, 0x1A03, 0x485, 255, (0x30010008, 0x20030020)),
    [_write(0x1803, 3, 100, 2), _write(0x1803, 5, 20, 2), _START, (PAUSE, 50)],
    [_write(0x1402, 1, 0x80000186, 4), _write(0x1802, 1, 0x80000385, 4)],
    [_write(0x1803, 1, 0x80000485, 4), _write(0x1803, 3, 0, 2), _write(0x1803, 5, 0, 2)],
    [_command(nmt.ENTER_PRE_OPERATIONAL), (SERVER, b"\x23\x10\x10\x01save")],
    [_command(nmt.ENTER_PRE_OPERATIONAL), (SERVER, b"\x23\x10\x10\x03save"), (POWER, 0), _BOOT],
    [_command(nmt.ENTER_PRE_OPERATIONAL), (MEMORY, 1), (SERVER, b"\x23\x10\x10\x02save")],
    [(SERVER, b"\x23\x11\x10\x01load"), _command(nmt.RESET_NODE), _BOOT],
    [(SERVER, b"\x23\x11\x10\x02load"), (POWER, 0), _BOOT, (MEMORY, 0)],
    _segments(0x2000, 0, b"\x10\x27\0\0", 1),
    _segments(0x6883, 0, b"\x10\x27\0", 0),
    _segments(0x2000, 0, bytes(range(40)), 0),
    _blocks(0x2000, 0, bytes(range(75)), 6),
    _blocks(0x2800, 0, b"\x10\x27\0\0", 2),
    [_read(0x1008, 0), (SERVER, b"\x60" + bytes(7)), (SERVER, b"\x70" + bytes(7))],
    [_read(0x1009, 0), (SERVER, b"\x60" + bytes(7)), (PAUSE, 1100)],
    _block_upload(0x1009, 0, 2, 3),
    _block_upload(0x1008, 0, 127, 2),
    _block_upload(0x1009, 0, 1, 3)[:5],
    [_block_upload(0x100A, 0, 1, 1), (ROOM, 1), _block_upload(0x1009, 0, 7, 3), (ROOM, 0)],
    [_NO_ID, _command(nmt.RESET_NODE), (PAUSE, 5), _fast_scan(), _NEW_ID],
    [_NO_ID, _lss(lss.IDENTIFY_UNCONFIGURED), _command(nmt.RESET_NODE), _fast_scan(), _NEW_ID],
    [_lss_number(lss.SWITCH_VENDOR + part, _IDENTITY[part]) for part in range(4)]
    + [_lss(command) for command in range(lss.INQUIRE_VENDOR, lss.INQUIRE_NODE_ID + 1)]
    + [_lss(lss.CONFIGURE_BIT_TIMING, 0, 0), _lss(lss.ACTIVATE_BIT_TIMING), _NEW_ID],
    [
        _lss_number(lss.IDENTIFY_VENDOR + step, _IDENTITY[part])
        for step, part in enumerate((0, 1, 2, 2, 3, 3))
    ],
    [(MEMORY, 1), _lss(lss.SWITCH_GLOBAL, 1), _lss(lss.STORE), (MEMORY, 0), _NEW_ID],
)


def _flat(frames):
    """A list without lists in it; MicroPython's displays know no stars."""
    flat = []
    for frame in frames:
        if isinstance(frame, list):
            flat.extend(_flat(frame))
        else:
            flat.append(frame)
    return flat


SEQUENCES = [_flat(frames) for frames in _SERVICES]
