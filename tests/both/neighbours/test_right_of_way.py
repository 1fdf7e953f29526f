"""A cell's right of way on either interpreter: one sequence of decisions from seeded estimates."""

from array import array

from mdms_cell.rights.right_of_way import RightOfWay
from mdms_protocol.neighbours import frames as wire


def test_same_estimates_lead_to_the_same_decisions():
    cell = RightOfWay(lease_beats=5, late_beats=1, hold_beats=2, hops=2, patience_beats=16)
    seed = 1
    digest = 0
    states = [0, 0, 0, 0]
    estimates = array("h", [0] * (8 * wire.ESTIMATE_FIELDS))
    fresh = bytearray(8)
    for beat in range(4000):
        if beat % 1000 == 999:
            cell.restart()
        if beat % 170 == 169:
            cell.on_gap()
        for direction in range(8):
            seed = (seed * 1103 + 12345) % 1048573
            kind = seed >> 4
            fresh[direction] = 1 if kind % 3 else 0
            phase = beat // 40 + direction // 3
            at = direction * wire.ESTIMATE_FIELDS
            estimates[at + wire.IDENTITY] = phase % 3
            estimates[at + wire.STATE] = 3 - kind % 2
            estimates[at + wire.WANTS] = 0xFF if kind % 5 < 4 else 0
            estimates[at + wire.HOLD] = 5 if kind % 11 else kind % 6
        cell.on_estimates(estimates, fresh)
        over = (beat // 60 % 4) % 3
        cell.on_beat(over, seed % 256 & seed // 256, beat % 7 == 0)
        states[cell.state] += 1
        for number in (cell.identity, cell.state, cell.hold, cell.drive_beats, cell.lacking):
            digest = (digest * 257 + number) % 1048573
    assert min(states) > 10, states
    assert digest == 769919, digest
