"""A cell's right of way on either interpreter: one sequence of decisions from seeded estimates."""

from mdms_cell.neighbours.right_of_way import RightOfWay


def test_same_estimates_lead_to_the_same_decisions():
    cell = RightOfWay(lease_beats=5, late_beats=1, hold_beats=2, hops=2, patience_beats=16)
    seed = 1
    digest = 0
    states = [0, 0, 0, 0]
    for beat in range(4000):
        if beat % 1000 == 999:
            cell.restart()
        if beat % 170 == 169:
            cell.on_gap()
        for direction in range(8):
            seed = (seed * 1103 + 12345) % 1048573
            kind = seed >> 4
            if kind % 3:
                phase = beat // 40 + direction // 3
                cell.on_message(
                    direction, phase % 3, 3 - kind % 2, kind % 5 < 4, 5 if kind % 11 else kind % 6
                )
        over = (beat // 60 % 4) % 3
        cell.on_beat(over, seed % 256 & seed // 256, beat % 7 == 0)
        states[cell.state] += 1
        numbers = (cell.identity, cell.state, cell.hold, cell.drive_beats, cell.lacking)
        for number in numbers + (cell.blocked + 0,):  # noqa: RUF005 - not in MicroPython
            digest = (digest * 257 + number) % 1048573
    assert min(states) > 10, states
    assert digest == 423818, digest
