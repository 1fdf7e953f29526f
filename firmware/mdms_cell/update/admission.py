"""Whether a bundle is for this cell, by its head alone: before anything of it is written."""

from mdms_cell.update.signature import key_id, same, sign
from mdms_protocol.update import bundle, codes


def refusal(data, key, target, counter, room):
    """The reason why a bundle with these first bytes is refused, 0 if it is not.

    `target` are board, bytecode and version number of this cell, `counter` is that of the last
    bundle that was confirmed, `room` what a slot takes, and memory of its image [bytes].
    """
    head = bundle.unpack(data)
    if head is None:
        return codes.NO_BUNDLE
    if not key:
        return codes.NO_KEY
    if head.key_id != key_id(key):
        return codes.FOREIGN
    if not same(sign(key, data[: bundle.SIGNED_SIZE]), data[bundle.SIGNED_SIZE : bundle.HEAD_SIZE]):
        return codes.FORGED
    return _unfit(head, *target) or _unwanted(head, target[2], counter, room)


def _unfit(head, board, bytecode, _version):
    if not head.boards >> board & 1:
        return codes.OTHER_BOARD
    return codes.OTHER_BYTECODE if head.bytecode != bytecode else 0


def _unwanted(head, version, counter, room):
    if head.counter <= counter:
        return codes.REPLAYED
    if head.version < version and not head.flags & bundle.OLDER_ALLOWED:
        return codes.OLDER
    return codes.TOO_LARGE if head.size > room[0] or head.image_size > room[1] else 0
