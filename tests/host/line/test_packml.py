"""The state machine of PackML by its one table of transitions."""

import pytest

from mdms_host.line.packml import (
    DONE,
    MOVES,
    MOVING,
    TRANSITIONS,
    Command,
    CommandRefusedError,
    Mode,
    State,
    StateMachine,
)


def reached(*causes) -> StateMachine:
    machine = StateMachine()
    for number, cause in enumerate(causes):
        machine.on(cause, float(number))
    return machine


def test_a_machine_comes_from_stopped_to_execute_and_back() -> None:
    machine = reached(Command.RESET, DONE, Command.START, DONE)
    assert machine.state is State.EXECUTE
    machine.on(Command.STOP, 10.0)
    machine.on(DONE, 11.0)
    assert machine.state is State.STOPPED
    assert machine.in_state_s(State.EXECUTE, 20.0) == pytest.approx(7.0)
    assert machine.in_state_s(State.STOPPED, 20.0) == pytest.approx(9.0)


@pytest.mark.parametrize(
    "state", [state for state in State if state not in (State.ABORTING, State.ABORTED)]
)
def test_abort_is_possible_in_every_state(state) -> None:
    assert TRANSITIONS[state, Command.ABORT] is State.ABORTING


def test_in_maintenance_refusals_name_only_commands_that_are_taken() -> None:
    machine = StateMachine(mode=Mode.MAINTENANCE)
    with pytest.raises(CommandRefusedError, match="change the mode first"):
        machine.after(Command.RESET)
    with pytest.raises(CommandRefusedError, match=r"not possible in Stopped; possible: Abort$"):
        machine.after(Command.START)
    machine.on(Command.ABORT, 1.0)
    machine.on(DONE, 2.0)
    # The mode cannot be changed here, nor can Stop be given: Clear comes first.
    with pytest.raises(CommandRefusedError, match=r"not possible in Aborted; possible: Clear$"):
        machine.after(Command.RESET)
    with pytest.raises(CommandRefusedError, match="not changed in Aborted, but in Stopped alone"):
        machine.change_mode(Mode.PRODUCTION)


def test_only_three_commands_lead_to_a_state_in_which_parcels_move() -> None:
    """Whatever else happens: Clear, Reset, Stop and Hold start nothing."""
    for (state, cause), after in TRANSITIONS.items():
        if after in MOVING and state not in MOVING:
            before = [each for (_, each), to in TRANSITIONS.items() if to is state]
            assert cause is DONE
            assert all(each in MOVES for each in before), (state, before)


def test_every_state_is_left_and_every_acting_state_ends_by_itself() -> None:
    for state in State:
        assert any(each is state for each, _ in TRANSITIONS)
        if state.name.endswith("ING"):
            assert (state, DONE) in TRANSITIONS
