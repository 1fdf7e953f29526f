"""The motors' supply goes while cells steer, and comes back: wheels wait for a command."""

from layer_bench import NEIGHBOURS, NODE, Middle, some_of, targets_um_s

from mdms_cell.drive import speed_loop
from mdms_protocol import indices, pdo
from mdms_protocol.codecs import cia402, cob
from mdms_protocol.neighbours import frames as wire

COUNTS_PER_METRE = 37_596
SPEED_UM_S = 100_000
SUPPLY_UV = 24_000_000
BASES = (0, speed_loop.AXIS)
UNDERVOLTAGE = 0x3220
#: The program allows 0.44 m/s2: so much faster in each beat [um/s].
STEP_UM_S = 4_400
#: How long the button stays pressed [beats]: less than a rest, and more.
PRESSED_BEATS = (10, 60)


class Powered(Middle):
    """Its tick runs, its first wheel follows its reference, and its supply may go."""

    supply_uv = SUPPLY_UV
    travel_nm = 0
    #: Whether any wheel has had a voltage since this was set to False.
    driven = False
    #: Its tick does not run until it is set up.
    ticks = False
    #: The nodes whose statuswords say that their supply is gone, and those whose states get lost.
    unsupplied = losing_of = ()

    def __init__(self, speed_um_s):
        #: The codes of the emergencies that it has sent since this was emptied.
        self.codes = set()
        super().__init__(speed_um_s)
        self.ticks = True

    def _pass(self, time_ms):
        if not self.ticks:
            super()._pass(time_ms)
            return
        registers = self.cell._registers
        for _ in range(time_ms):
            registers[speed_loop.SUPPLY] = self.supply_uv
            self.travel_nm += registers[speed_loop.DEMAND]
            registers[speed_loop.COUNT] = self.travel_nm * COUNTS_PER_METRE // 1_000_000_000
            self.cell.tick()
            self.driven |= any(registers[base + speed_loop.VOLTAGE] for base in BASES)
            super()._pass(1)

    def beat(self, moving=True):
        super().beat(moving)
        self.listen()

    def _presence(self, direction):
        node = NEIGHBOURS[direction]
        words = self.words
        if node in self.unsupplied:
            self.words = bytes((words[0] & ~cia402.VOLTAGE_ENABLED,)) + words[1:]
        self.losing = node in self.losing_of
        super()._presence(direction)
        self.words = words

    def listen(self):
        for can_id, data in self.board.take():
            if can_id == cob.EMCY_BASE + NODE:
                self.codes.add(data[0] | data[1] << 8)

    def beats(self, count, moving):
        for _ in range(count):
            self.beat(moving)

    def control(self, *words):
        for word in words:
            frame = pdo.CONTROLWORD.encode((word, word))
            self.cell.on_frame(cob.RPDO_BASES[1] + NODE, frame, self.now_ms)

    def states(self):
        word = self.cell._objects.reader
        offsets = (0, indices.AXIS_OFFSET)
        return [word(indices.STATUSWORD + offset, 0)[0]() & 0x6F for offset in offsets]


def moving():
    middle = Powered(SPEED_UM_S)
    middle.beats(20, moving=True)
    assert middle.states()[0] == cia402.OPERATION_ENABLED
    return middle


def waiting():
    """The wheels rest, for a promise is lacking."""
    middle = moving()
    middle.silent = NEIGHBOURS[0]
    middle.beats(100, moving=False)
    assert middle.states() == [cia402.SWITCHED_ON] * 2
    return middle


def ramped_down():
    middle = moving()
    middle.silent = NEIGHBOURS[0]
    middle.beats(15, moving=True)
    assert 0 < middle.cell._registers[speed_loop.DEMAND] < SPEED_UM_S
    return middle


def held():
    """The wheels hold the parcel, which stands."""
    middle = moving()
    middle.silent = NEIGHBOURS[0]
    middle.beats(50, moving=False)
    assert middle.states()[0] == cia402.OPERATION_ENABLED
    assert middle.cell._registers[speed_loop.DEMAND] == 0
    return middle


def braking():
    """SYNC is gone, and the tick has begun to brake."""
    middle = moving()
    middle._pass(52)
    assert middle.states()[0] == cia402.FAULT_REACTION
    return middle


def emergencies(middle):
    """The codes of those that it has sent since the last call."""
    middle.listen()
    codes, middle.codes = middle.codes, set()
    return codes


def test_releasing_the_emergency_stop_turns_no_wheel_whatever_the_cell_did():
    begins = (waiting, moving, ramped_down, held, braking)
    for begin, pressed_beats in some_of([(each, n) for each in begins for n in PRESSED_BEATS]):
        middle = begin()
        emergencies(middle)
        middle.supply_uv = 0
        middle._pass(6)
        assert middle.states() == [cia402.FAULT] * 2, begin
        middle.driven = False
        middle.beats(pressed_beats, moving=False)
        # The button is released, and the promise comes.
        middle.supply_uv = SUPPLY_UV
        middle.silent = None
        middle.beats(20, moving=False)
        assert not middle.driven, begin
        assert UNDERVOLTAGE in emergencies(middle)
        # Nor by what would enable a drive that has no fault.
        middle.control(cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION)
        middle.beats(10, moving=False)
        assert not middle.driven, begin


def test_wheels_turn_again_once_another_node_has_reset_the_fault_and_switched_them_on():
    middle = waiting()
    middle.supply_uv = 0
    middle.beats(20, moving=False)
    middle.supply_uv = SUPPLY_UV
    middle.silent = None
    middle.beats(20, moving=False)
    middle.driven = False
    middle.control(cia402.DISABLE_VOLTAGE, cia402.FAULT_RESET)
    middle.beats(20, moving=False)
    assert not middle.driven
    middle.control(cia402.SHUTDOWN, cia402.SWITCH_ON)
    middle.beats(20, moving=False)
    assert middle.driven


def test_reset_of_the_fault_while_the_button_is_pressed_leads_to_the_fault_again():
    middle = waiting()
    middle.silent = None
    middle.supply_uv = 0
    middle.beats(20, moving=False)
    middle.driven = False
    for _ in range(3):
        words = (cia402.DISABLE_VOLTAGE, cia402.FAULT_RESET, cia402.SHUTDOWN, cia402.SWITCH_ON)
        middle.control(*words)
        middle._pass(2)
        assert middle.states() == [cia402.FAULT] * 2
        middle.beats(5, moving=False)
    middle.supply_uv = SUPPLY_UV
    middle.beats(100, moving=False)
    assert not middle.driven


def test_cell_that_the_button_restarts_is_off_until_it_is_commanded():
    middle = moving()
    middle.supply_uv = 0
    middle._pass(10)
    # Its own supply goes, too: all that it had in memory is lost.
    middle.cell.on_frame(cob.NMT, bytes((129, NODE)), middle.now_ms)
    middle.driven = False
    middle.supply_uv = SUPPLY_UV
    middle.beats(100, moving=False)
    assert middle.states() == [cia402.SWITCH_ON_DISABLED] * 2
    middle.cell.on_frame(cob.NMT, bytes((1, NODE)), middle.now_ms)
    middle._pages()
    middle.beats(100, moving=False)
    assert middle.states() == [cia402.SWITCH_ON_DISABLED] * 2
    assert not middle.driven


def test_low_supply_of_a_cell_that_is_off_is_reported_and_is_no_fault():
    for words, state in (
        ((), cia402.SWITCH_ON_DISABLED),
        ((cia402.SHUTDOWN,), cia402.READY_TO_SWITCH_ON),
    ):
        middle = waiting()
        middle.control(cia402.DISABLE_VOLTAGE, *words)
        emergencies(middle)
        middle.supply_uv = 0
        middle._pass(20)
        assert UNDERVOLTAGE in emergencies(middle)
        middle.supply_uv = SUPPLY_UV
        middle._pass(20)
        assert emergencies(middle) == {0}
        assert middle.states() == [state] * 2


def test_cell_that_measures_a_supply_heeds_the_stop_by_what_most_neighbours_say():
    for most, begin in ((True, moving), (True, waiting), (False, moving)):
        middle = begin()
        emergencies(middle)
        middle.unsupplied = NEIGHBOURS[: 5 if most else 4]
        middle.beats(4, moving=most)
        assert cia402.FAULT not in middle.states()
        middle.beats(20, moving=False)
        assert (middle.states() == [cia402.FAULT] * 2) == most
        assert (UNDERVOLTAGE in emergencies(middle)) == most
        if not most:
            continue
        middle.driven = False
        middle.unsupplied = ()
        middle.silent = None
        middle.beats(40, moving=False)
        assert not middle.driven
        middle.control(cia402.DISABLE_VOLTAGE, cia402.FAULT_RESET)
        middle.control(cia402.SHUTDOWN, cia402.SWITCH_ON)
        middle.beats(20, moving=False)
        assert middle.driven
        assert emergencies(middle) == {0}


def test_neighbours_whose_supply_is_gone_count_while_they_are_heard():
    middle = moving()
    middle.unsupplied = NEIGHBOURS[:2]
    middle.losing_of = NEIGHBOURS[2:]
    # The six others say nothing, and count for 0.22 s.
    middle.beats(40, moving=True)
    assert middle.states() == [cia402.FAULT] * 2


def pressed():
    """The button was pressed under way, and is released."""
    middle = moving()
    middle.supply_uv = 0
    middle.beats(20, moving=False)
    middle.supply_uv = SUPPLY_UV
    middle.beats(10, moving=False)
    return middle


def commanded(word):
    """Another node has given this controlword under way."""
    middle = moving()
    middle.control(word)
    return middle


def test_wheels_that_come_back_begin_as_slowly_as_under_any_parcel_that_stands():
    reset = (cia402.DISABLE_VOLTAGE, cia402.FAULT_RESET, cia402.SHUTDOWN, cia402.SWITCH_ON)
    enabled = (cia402.SHUTDOWN, cia402.SWITCH_ON)
    for stop, words in (
        (pressed, reset),
        (braking, reset),
        (lambda: commanded(cia402.QUICK_STOP), enabled),
        (lambda: commanded(cia402.SHUTDOWN), enabled),
        (lambda: commanded(cia402.SWITCH_ON | cia402.CONTROL_HALT), enabled[1:]),
    ):
        middle = stop()
        middle.beats(60, moving=False)
        assert targets_um_s(middle) == (0, 0)
        middle.control(*words)
        before_um_s = 0
        for _ in range(30):
            middle.beat(moving=False)
            target_um_s = targets_um_s(middle)[0]
            assert target_um_s <= before_um_s + 2 * STEP_UM_S, words
            before_um_s = target_um_s
        assert before_um_s > 10 * STEP_UM_S


def driven_without_the_host():
    """The host is watched, and is gone from now on."""
    middle = Powered(SPEED_UM_S)
    middle._write(indices.CONSUMER_TIMES, 1, 4, (cob.HOST_NODE << 16) | 75)
    middle.sequence = middle.its_sequence = 2
    middle.program_flags = wire.GO_ON
    middle._pages()
    middle.cell.on_frame(cob.HEARTBEAT_BASE + cob.HOST_NODE, b"\x05", middle.now_ms)
    middle.beats(20, moving=True)
    assert middle.driven
    return middle


def lose_supply(middle):
    middle.supply_uv = 0
    middle.beats(20, moving=False)


def miss_supply(middle):
    """Its measurement is stuck for a while: neighbours have forgotten the goal, it has not."""
    middle.unsupplied = NEIGHBOURS
    middle.beats(20, moving=False)


def miss_sync(middle):
    """Nobody gives the beat, so there is no update while there is a fault."""
    middle._pass(500)


def go_off_the_bus(middle):
    """The same, after which the bus is back."""
    middle.cell.fail(0x8140)
    middle._pass(200)
    middle.cell.recover()


def test_reset_of_the_fault_without_the_host_moves_nothing_until_there_is_a_new_goal():
    for fail in (lose_supply, miss_supply, miss_sync, go_off_the_bus):
        middle = driven_without_the_host()
        fail(middle)
        middle.supply_uv, middle.unsupplied = SUPPLY_UV, ()
        middle.its_sequence, middle.its_flags = 0, wire.LACKING
        middle.control(cia402.DISABLE_VOLTAGE, cia402.FAULT_RESET)
        middle.driven = False
        middle.control(cia402.SHUTDOWN, cia402.SWITCH_ON)
        middle._pass(100)
        middle.beats(20, moving=False)
        assert not middle.driven, fail
        middle.sequence = middle.its_sequence = 3
        middle.its_flags = 0
        middle._pages()
        middle.beats(20, moving=False)
        assert middle.driven
