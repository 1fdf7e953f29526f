"""The proof that a sender has the array's key: HMAC-SHA256 (RFC 2104)."""

import hashlib

_BLOCK = 64


def sign(key, data):
    """The code of some data under a key of at most 64 bytes."""
    inner = hashlib.sha256(_padded(key, 0x36))
    inner.update(data)
    outer = hashlib.sha256(_padded(key, 0x5C))
    outer.update(inner.digest())
    return outer.digest()


def key_id(key):
    """Four bytes that stand for a key and reveal nothing of it; zeros for none."""
    return sign(key, b"MDMS update key")[:4] if key else bytes(4)


def same(one, other):
    """Whether two codes are the same, in a time that does not depend on where they differ."""
    difference = len(one) ^ len(other)
    for place in range(min(len(one), len(other))):
        difference |= one[place] ^ other[place]
    return not difference


def _padded(key, pad):
    return bytes(byte ^ pad for byte in key + bytes(_BLOCK - len(key)))
