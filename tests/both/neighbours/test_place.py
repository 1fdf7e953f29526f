"""A cell's place and neighbours, as its object dictionary has them."""

from mdms_cell.canopen.objects import Objects, find
from mdms_cell.perception import place as p
from mdms_protocol import indices


def write(objects, index, sub, number):
    entry = find(index, sub)
    objects.write(entry, number.to_bytes(4, "little")[: entry.size])


def made():
    objects = Objects()
    changes = []
    return objects, p.Place(objects, lambda others: others and changes.append(1)), changes


def test_cell_has_no_place_until_it_is_given_one():
    objects, place, _ = made()
    assert not place.known
    assert sum(place.nodes) == 0
    write(objects, indices.PLACE, 1, 3)
    assert not place.known
    write(objects, indices.PLACE, 2, 2)
    assert place.known
    assert (place.column, place.row) == (3, 2)


def test_first_column_and_row_are_a_place():
    objects, place, _ = made()
    write(objects, indices.PLACE, 1, 1)
    write(objects, indices.PLACE, 2, 1)
    assert place.known
    write(objects, indices.PLACE, 2, 0)
    assert not place.known


def test_only_a_change_of_neighbours_sets_filters_anew():
    objects, _, changes = made()
    write(objects, indices.PLACE, 1, 3)
    assert not changes
    write(objects, indices.PLACE, 2, 2)
    assert len(changes) == 1
    write(objects, indices.NEIGHBOURS, 4, 9)
    assert len(changes) == 2
    write(objects, indices.NEIGHBOURS, 4, 9)
    write(objects, indices.PLACE, 3, 127_000)
    write(objects, indices.SENSOR_OFFSETS, 1, 1)
    assert len(changes) == 2


def test_neighbours_stand_a_pitch_away():
    objects, place, _ = made()
    write(objects, indices.PLACE, 5, 100_000)
    shifts = [place.shift_um(direction) for direction in range(p.DIRECTIONS)]
    near, far = 100_000, -100_000
    assert shifts[:4] == [(near, 0), (near, near), (0, near), (far, near)]
    for direction in range(p.DIRECTIONS):
        x_um, y_um = shifts[direction ^ 4]
        assert shifts[direction] == (-x_um, -y_um)


def test_direction_of_a_neighbour_follows_from_its_column_and_row():
    objects, place, _ = made()
    for sub, number in ((1, 3), (2, 2)):
        write(objects, indices.PLACE, sub, number)
    for sub in range(p.DIRECTIONS):
        write(objects, indices.NEIGHBOURS, sub + 1, 10 + sub)
    steps = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))
    assert [place.direction_of(3 + x, 2 + y) for x, y in steps] == list(range(p.DIRECTIONS))
    assert place.direction_of(3, 2) is place.direction_of(5, 2) is place.direction_of(3, 0) is None
    write(objects, indices.NEIGHBOURS, 7, 0)
    assert place.direction_of(3, 1) is None


def test_wheels_and_sensors_are_the_prototypes_until_they_are_set():
    objects, place, _ = made()
    assert [place.contact_um(axis) for axis in range(2)] == [(-30_000, 0), (30_000, 0)]
    assert [place.drive(axis) for axis in range(2)] == [(p.UNITY, 0), (0, p.UNITY)]
    assert [place.sensor_um(number) for number in range(2)] == [(0, 0), (31_750, 31_750)]
    assert place.pitch_um == 127_000
    write(objects, indices.CONTACT_Y + indices.AXIS_OFFSET, 0, 7_000)
    write(objects, indices.DIRECTION, 0, 3_141_593)
    write(objects, indices.SENSOR_OFFSETS, 10, 5)
    assert place.contact_um(1) == (30_000, 7_000)
    assert place.drive(0) == (-p.UNITY, 0)
    assert place.sensor_um(4) == (31_750, 5)


def test_only_neighbours_that_there_are_and_the_host_are_listened_to():
    objects, place, _ = made()
    assert list(place.receivers()) == [(0x47F, p.PROGRAM, p.HOST)]
    write(objects, indices.NEIGHBOURS, 1, 7)
    write(objects, indices.NEIGHBOURS, 6, 18)
    write(objects, indices.RPDO_PARAMETERS + 2, 1, 0x8000047F)
    assert list(place.receivers()) == [
        (0x187, p.SPEEDS, 0),
        (0x287, p.STATE, 0),
        (0x387, p.ESTIMATE, 0),
        (0x487, p.PROGRAM, 0),
        (0x192, p.SPEEDS, 5),
        (0x292, p.STATE, 5),
        (0x392, p.ESTIMATE, 5),
        (0x492, p.PROGRAM, 5),
    ]
