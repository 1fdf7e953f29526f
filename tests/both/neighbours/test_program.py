"""The pages of a program, on every interpreter: in any order, twice, late, or never."""

from array import array

from mdms_cell.motion.program import SLOTS, Program, Programs
from mdms_protocol.neighbours import frames as wire

IDENTITY = 5
#: Where the goal of a way of three lies, and where the legs after it end, in steps of the wire.
WAY = ((100, 0, 0), (100, 200, 0), (-300, 200, 512))


def parcel_page(sequence=1, flags=wire.GO_ON, identity=IDENTITY):
    fields = (identity, wire.PARCEL, sequence, wire.RECTANGLE, 1200, 1120, 44, 20, flags)
    return array("i", fields)


def goal_page(place, sequence=1, leg=0, legs=2):
    x, y, yaw = place
    return array("i", (IDENTITY, wire.GOAL, sequence, x, y, yaw, leg, legs, 0))


def leg_page(leg, sequence=1, way=WAY):
    return goal_page(way[leg], sequence, leg, len(way) - 1)


def given(*pages):
    program = Programs().place_for(IDENTITY)
    for page in pages:
        program.take(page)
    return program


def whole():
    return given(parcel_page(), goal_page(WAY[0]), leg_page(1), leg_page(2))


def goal(program):
    x_um, y_um, _ = program.place(0)
    return x_um // wire.STEP_UM, y_um // wire.STEP_UM


def rest(program):
    """The goal, and those of all legs that can be gone to after it."""
    goals = [goal(program)]
    while program.advance():
        goals.append(goal(program))
    return goals


def test_goal_without_legs_is_all_of_its_way():
    program = given(parcel_page(), goal_page(WAY[0], legs=0))
    assert program.whole
    assert not program.advance()
    assert (goal(program), program.sequence) == (WAY[0][:2], 1)


def test_legs_follow_one_after_the_other_each_as_a_program_of_the_next_sequence():
    program = whole()
    sequences = []
    assert program.whole
    while program.advance():
        sequences.append(program.sequence)
        assert program.whole
    assert sequences == [2, 3]
    assert rest(whole()) == [place[:2] for place in WAY]


def test_no_parcel_goes_beyond_a_lacking_leg():
    program = given(parcel_page(), goal_page(WAY[0]), leg_page(2))
    assert program.complete
    assert not program.whole
    assert not program.advance()
    assert program.take(leg_page(1))
    assert program.whole
    assert program.known_legs() == 2


def test_leg_that_comes_twice_or_before_its_goal_or_of_another_program_changes_nothing():
    program = given(parcel_page(), leg_page(1))
    program.take(goal_page(WAY[0]))
    assert not program.whole
    program = whole()
    for page in (leg_page(1), leg_page(1, way=((0, 0, 0),) * 3), leg_page(2, sequence=2)):
        assert not program.take(page)
    assert rest(program) == [place[:2] for place in WAY]


def test_goal_that_comes_twice_keeps_the_legs():
    program = whole()
    program.take(goal_page(WAY[0]))
    assert program.whole


def test_goal_of_another_way_drops_the_legs():
    for page in (
        goal_page((7, 7, 0), sequence=2),
        goal_page(WAY[1], sequence=2, legs=1),
        goal_page((7, 7, 0), sequence=1),
        goal_page((7, 7, 0), sequence=3, leg=wire.JOINS),
    ):
        program = whole()
        program.take(page)
        assert program.complete
        assert not program.whole
        assert not program.advance()


def test_goal_that_is_only_turned_otherwise_drops_the_legs():
    program = whole()
    x, y, _ = WAY[0]
    program.take(goal_page((x, y, 512)))
    assert program.known_legs() == 0
    assert not program.whole
    assert program.place(0)[2] != given(parcel_page(), goal_page(WAY[0])).place(0)[2]


def test_legs_that_are_taken_back_are_not_gone():
    program = whole()
    program.take(goal_page(WAY[0], sequence=2, legs=0))
    assert program.whole
    assert not program.advance()


def test_host_that_sets_the_next_goal_of_the_way_leaves_the_rest_of_it():
    program = whole()
    program.take(goal_page(WAY[1], sequence=2, leg=wire.JOINS, legs=1))
    assert program.whole
    assert rest(program) == [WAY[1][:2], WAY[2][:2]]


def test_goal_before_the_next_one_of_the_way_leaves_all_that_follow():
    program = whole()
    program.take(goal_page((150, 50, 0), sequence=2, leg=wire.JOINS, legs=2))
    assert rest(program) == [(150, 50), WAY[1][:2], WAY[2][:2]]


def test_way_that_joins_and_is_longer_lacks_the_new_legs():
    program = whole()
    program.take(goal_page(WAY[1], sequence=2, leg=wire.JOINS, legs=2))
    assert not program.whole
    program.take(goal_page((0, 0, 0), sequence=2, leg=2, legs=2))
    assert rest(program) == [WAY[1][:2], WAY[2][:2], (0, 0)]


def test_host_that_sets_the_goal_that_the_cell_has_come_to_by_itself_changes_nothing():
    program = whole()
    program.advance()
    program.take(goal_page(WAY[1], sequence=2, leg=wire.JOINS, legs=1))
    assert program.whole
    assert rest(program) == [WAY[1][:2], WAY[2][:2]]


def test_pages_that_are_handed_on_make_the_same_program():
    program, other = whole(), given()
    program.advance()
    frame, fields = bytearray(8), array("i", [0] * wire.PROGRAM_FIELDS)
    handed_on = 0
    for number in range(wire.LEGS_MAX + 2):
        if program.pack(number, frame, 0):
            handed_on += 1
            assert wire.unpack_program(frame, fields)
            other.take(fields)
    assert handed_on == 3
    assert other.whole
    assert (other.sequence, other.legs) == (2, 1)
    assert rest(other) == rest(program)


def test_program_that_is_dropped_has_no_way():
    programs = Programs()
    program = programs.place_for(IDENTITY)
    for page in (parcel_page(), goal_page(WAY[0]), leg_page(1), leg_page(2)):
        program.take(page)
    programs.drop(IDENTITY)
    program = programs.place_for(IDENTITY)
    assert isinstance(program, Program)
    assert not program.advance()
    assert (program.complete, program.whole, program.legs) == (False, False, 0)


def test_goal_that_others_may_have_passed_is_none_until_it_is_handed_on():
    programs = Programs()
    program = programs.place_for(IDENTITY)
    for page in (parcel_page(), goal_page(WAY[0]), leg_page(1), leg_page(2)):
        program.take(page)
    programs.outdate(IDENTITY)
    assert program.whole
    programs.outdate(0)
    assert (program.complete, program.has_parcel) == (False, True)
    assert not program.advance()
    # The wheels wait for it all the same when the host is gone.
    assert programs.go_on()
    # Three legs on sequence numbers are the same again.
    program.take(goal_page((7, 8, 0), 1, legs=0))
    assert (goal(program), program.whole) == ((7, 8), True)
    programs.drop(IDENTITY)
    assert not programs.go_on()


def kept(programs):
    return [each for each in range(1, wire.IDENTITY_MAX + 1) if programs.find(each)]


def give(programs, identity, way):
    """A whole program of this way [steps]: the pages of parcel, place, goal and legs."""
    (x, y), *goals = way
    programs.place_for(identity).take(parcel_page(identity=identity))
    page = array("i", (identity, wire.PLACE, 1, x, y, 0, 0, 0, 0))
    programs.find(identity).begin_at(page)
    for leg, (goal_x, goal_y) in enumerate(goals):
        page = array("i", (identity, wire.GOAL, 1, goal_x, goal_y, 0, leg, len(goals) - 1, 0))
        programs.place_for(identity).take(page)


#: Far from a cell at the origin, and ways that come near it.
FAR = ((9000, 9000), (9500, 9000))
BY_IT = ((-2000, 0), (2000, 10))


def far_parcels(programs, first=1):
    for identity in range(first, wire.IDENTITY_MAX + 1):
        give(programs, identity, FAR)


def test_programs_of_parcels_that_come_near_are_kept_whatever_comes_after_them():
    programs = Programs()
    near = range(1, SLOTS)
    for identity in near:
        give(programs, identity, BY_IT)
    far_parcels(programs, SLOTS)
    assert kept(programs)[:-1] == list(near)
    assert all(programs.find(identity).complete for identity in near)


def test_way_is_as_far_away_as_the_box_around_it():
    for way in (((-2000, -1000), (2000, 3000)), ((2000, 3000), (500, 600), (-2000, -1000))):
        programs = Programs()
        give(programs, 1, way)
        away = programs.find(1).away
        assert away(0, 0) == away(-2000, 3000) == 0
        assert (away(2500, 0), away(-2600, 0)) == (500, 600)
        assert (away(0, 3400), away(0, -1300)) == (400, 300)


def test_parcel_that_comes_near_at_the_end_of_its_legs_only_is_near():
    programs = Programs()
    give(programs, 1, ((9000, 9000), (9500, 9000), (9000, 0), (100, 0)))
    far_parcels(programs, 2)
    assert programs.find(1).whole


def test_parcel_that_comes_near_finds_a_place_among_those_that_do_not():
    programs = Programs()
    far_parcels(programs)
    give(programs, 1, BY_IT)
    far_parcels(programs, 2)
    assert programs.find(1).complete


def test_program_of_which_nobody_says_where_it_leads_makes_room_first():
    programs = Programs()
    programs.place_for(1).take(parcel_page(identity=1))
    far_parcels(programs, wire.IDENTITY_MAX - SLOTS + 1)
    assert 1 not in kept(programs)


def test_parcel_that_is_said_to_lie_elsewhere_is_near_no_more():
    programs = Programs()
    for identity in range(1, SLOTS + 1):
        give(programs, identity, BY_IT)
    give(programs, 3, FAR)
    give(programs, SLOTS + 1, BY_IT)
    assert kept(programs) == [each for each in range(1, SLOTS + 2) if each != 3]


def test_own_programs_stay_however_far_they_lead():
    own = [1, 40]
    programs = Programs(lambda: own)
    give(programs, 1, FAR)
    give(programs, 40, FAR)
    for identity in range(2, 40):
        give(programs, identity, BY_IT)
    assert programs.find(1).complete
    assert programs.find(40).complete
    own.clear()
    give(programs, 41, BY_IT)
    give(programs, 42, BY_IT)
    assert not programs.find(1)
    assert not programs.find(40)
