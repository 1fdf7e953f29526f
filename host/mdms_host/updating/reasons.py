"""What cells report about firmware over the bus, in words."""

from mdms_protocol.update import codes

REASONS = {
    codes.NO_ROOM: "its board has no room for a second firmware",
    codes.NO_KEY: "it has no update key; mdms commission --key FILE gives it one",
    codes.NO_BUNDLE: "what came is no bundle",
    codes.FOREIGN: "the bundle is signed with another array's key",
    codes.FORGED: "the bundle is not what was signed",
    codes.OTHER_BOARD: "the bundle is for other boards",
    codes.OTHER_BYTECODE: "the bundle is for another version of MicroPython or another processor",
    codes.OLDER: "the bundle is older than what it runs; --allow-older signs that this is meant",
    codes.REPLAYED: "the bundle, or a later one, has been used before",
    codes.TOO_LARGE: "the bundle is larger than its slot",
    codes.TRUNCATED: "the bundle is not whole",
    codes.DAMAGED: "what its flash has is not what was signed",
    codes.DRIVING: "its motors are on, or brake still; turn them off first: mdms stop",
    codes.FLASH_FAILED: "its flash cannot be written",
    codes.NOT_CLEARED: "its slot was not cleared before",
    codes.NOTHING_TO_START: "it has no new firmware to start",
    codes.NOT_ON_TRIAL: "no firmware is on trial",
    codes.SELF_TEST: "it does not pass its self-test",
    codes.ROLLED_BACK: "the new firmware did not prove itself, and the one before runs again",
    codes.OTHER_KEY: "it has another array's key, which goes over USB only: remove update.key",
    codes.ON_TRIAL: "other firmware is on trial; it ends within a minute",
}


def reason_text(status: int) -> str | None:
    """The reason that 0x1F57:1 gives, in words; None for none."""
    number = codes.reason_of(status)
    return REASONS.get(number, f"reason {number}") if number else None
