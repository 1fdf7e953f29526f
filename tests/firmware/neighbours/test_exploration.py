"""The very module is explored to closure, and every rule of it is missed when it is gone."""

from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from tests.prove.cells import Rules
from tests.prove.exploration import CounterexampleError
from tests.prove.tables import QUICK, LostTable, Table

from mdms_cell.rights import declarations, right_of_way

ALONE = Table(2, 1, ((0,),), Rules(lease=3, late=1))
LONG_PARCEL = Table(4, 1, ((0, 1),), Rules(lease=3, late=1, disturbed=1), crash=False)
PAIR = Table(3, 1, ((0,), (2,)), Rules(lease=1, late=0, disturbed=0))

OVERHANG = Table(3, 1, ((0, 1), (2,)), Rules(lease=1, late=0))
#: The same, and no report tells whether the parcel reaches the square.
UNPLACED = Table(3, 1, ((0, 1), (2,)), Rules(lease=1, late=0, placed=False))

#: The replaced text, its replacement, the table on which that is missed, and the found violation.
MUTANTS = {
    "late estimates count for the whole lease": (
        "registers[_VALID_BEATS] = lease_beats - late_beats",
        "registers[_VALID_BEATS] = lease_beats",
        ALONE,
        "lease",
    ),
    "another is promised to at once": (
        "not (bound or occupied)",
        "not occupied",
        PAIR,
        "promised",
    ),
    "a reset ends all promises": (
        "registers[BOUND] = registers[_BOUND_BEATS] + 1  # beats;",
        "registers[BOUND] = 0  # beats;",
        PAIR,
        "the lease of",
    ),
    "a covered sensor keeps nobody away": (
        "not (bound or occupied)",
        "not bound",
        PAIR,
        "while another stands",
    ),
    "nothing lies over a cell that has restarted": (
        "if self.unsure:\n            here",
        "if False:\n            here",
        OVERHANG,
        "while another stands",
    ),
    "a neighbour that is not heard reports nothing": (
        "here = UNKNOWN\n            reported",
        "pass\n            reported",
        OVERHANG,
        "while another stands",
    ),
    "what lies here by report keeps nobody away": (
        "if here:\n            identity",
        "if False:\n            identity",
        OVERHANG,
        "while another stands",
    ),
    "a sensor that a parcel may cover whose place is not told keeps nobody away": (
        "occupied = occupied and identity != here",
        "occupied = False",
        UNPLACED,
        "while another stands",
    ),
    "the wait begins before the last announcement": (
        "if registers[STATE] >= PROMISED:\n        registers[BOUND] = registers[_BOUND_BEATS]",
        "if False:\n        registers[BOUND] = registers[_BOUND_BEATS]",
        ALONE,
        "the lease of",
    ),
    "the wait ends before the last wheel stands": (
        "registers[_BOUND_BEATS] = lease_beats + registers[_HOPS]",
        "registers[_BOUND_BEATS] = lease_beats + 0 * registers[_HOPS]",
        ALONE,
        "lease",
    ),
    "a promise to another parcel counts": (
        "identity == parcel and state >= PROMISED",
        "state >= PROMISED",
        PAIR,
        "two parcels",
    ),
    "a promise that is lacked is not missed": (
        "lacking |= wanted",
        "lacking |= 0",
        ALONE,
        "the lease of",
    ),
    "wheels turn beyond the lease": (
        "drive_beats = left\n",
        "pass\n",
        ALONE,
        "lease",
    ),
    "what was said to the cell before counts for the parcel on it": (
        "            self._drop_others()\n\n    def",
        "            pass\n\n    def",
        PAIR,
        "promised to two",
    ),
    "hold is not passed on": (
        "steps = step if step < steps else steps",
        "pass",
        LONG_PARCEL,
        "lease",
    ),
    "a promise outlives the wish": (
        "if not self._asks(promised):\n            return False",
        "if not self._asks(promised):\n            return True",
        PAIR,
        "stuck",
    ),
    "the parcel that had the cell goes first": (
        "self._asker(registers[_PREVIOUS]) or self._asker(0)",
        "self._asker(0)",
        PAIR,
        "stuck",
    ),
    "a cell under a parcel does not announce it": (
        "            self._promise(identity)\n            registers[STATE] = UNDER",
        "            self._promise(identity)",
        ALONE,
        "stuck",
    ),
}


@pytest.fixture
def mutant(request) -> Iterator[ModuleType]:
    """The module with one rule changed."""
    old, new = request.param
    source = Path(right_of_way.__file__).read_text()
    assert source.count(old) == 1
    module = ModuleType("mutant")
    exec(compile(source.replace(old, new), "mutant", "exec"), module.__dict__)
    return module


@pytest.mark.slow
@pytest.mark.parametrize("table", QUICK.values(), ids=QUICK)
def test_table_is_explored_to_closure(table):
    found = table.explore()
    print(f"{found.states:,} states, {found.transitions:,} transitions")


@pytest.mark.parametrize(
    ("mutant", "table", "seen"),
    [((old, new), table, seen) for old, new, table, seen in MUTANTS.values()],
    ids=MUTANTS,
    indirect=["mutant"],
)
def test_rule_is_missed_when_it_is_gone(mutant, table, seen):
    with pytest.raises(CounterexampleError, match=seen):
        table.explore(mutant)


#: The same of a lost cell: the module, what is replaced in it, by what, and whether a parcel has
#: come over the cell before.
MUTANTS_OF_LOST = {
    "a cell that is heard is taken for lost": (
        declarations,
        "if silent_beats < self._lost_beats:",
        "if False:",
        False,
    ),
    "a cell agrees that is promised to another": (
        declarations,
        "        if promised_to != identity:",
        "        promised_to = identity\n        if False:",
        False,
    ),
    "a round that begins anew counts as agreed": (
        declarations,
        "if newer == 1 and agreed_beats",
        "if newer and agreed_beats",
        False,
    ),
    "a request for the lost cell counts as its promise": (
        right_of_way,
        "        self.said[LEFT + direction] = 0\n\n    def approach",
        "        pass\n\n    def approach",
        False,
    ),
    "a cell that is back promises before it is restarted": (
        declarations,
        "if silent_beats < self._lost_beats:\n            self._withdraw(direction)",
        "if silent_beats < self._lost_beats:\n            self.revoke(direction)",
        True,
    ),
    "an agreement counts from when the next page comes": (
        declarations,
        "self._granted_beats[direction] = self._grant_beats - agreed_beats",
        "self._granted_beats[direction] = 20",
        True,
    ),
}


def test_first_states_with_a_lost_cell_break_no_rule():
    with pytest.raises(MemoryError):
        LostTable(crossing=False).explore(most_states=5_000)


@pytest.mark.parametrize(
    ("changed", "old", "new", "crossing"), MUTANTS_OF_LOST.values(), ids=MUTANTS_OF_LOST
)
def test_rule_of_a_lost_cell_is_missed_when_it_is_gone(changed, old, new, crossing):
    modules = {}
    for original in (declarations, right_of_way):
        source = Path(original.__file__).read_text()
        if original is changed:
            assert source.count(old) == 1
            source = source.replace(old, new)
        module = modules[original] = ModuleType("mutant")
        exec(compile(source, "mutant", "exec"), module.__dict__)
    mutant = modules[right_of_way]
    mutant.LostNeighbours = modules[declarations].LostNeighbours
    with pytest.raises(CounterexampleError, match=r"not kept|two parcels"):
        LostTable(crossing).explore(mutant, most_states=30_000)
