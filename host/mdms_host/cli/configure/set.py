"""`mdms configure set`: settings are checked, written, read back, and stored if that is wanted."""

import json
from argparse import Namespace
from collections.abc import Mapping, Sequence

from mdms_array.checks import motor_of
from mdms_host.cli.configure.cells import (
    open_commissioning,
    ranges,
    read_cells,
    show_changes,
    write_cells,
)
from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.streams import say
from mdms_host.commissioning.cell_settings import (
    BY_NAME,
    CellSettings,
    Change,
    Parameter,
    parse_assignments,
)
from mdms_model.loop_margin import GainError, Observer, check_gain
from mdms_model.scenario.file import load_scenario

#: What the speed loop's margin depends on, by axis; while it brakes it has another gain.
LOOPS = tuple(
    (f"axis{axis}.{gain}", f"axis{axis}.observer_lag", f"axis{axis}.acceleration_per_volt")
    for axis in (1, 2)
    for gain in ("gain", "braking_gain")
)


def run(arguments: Namespace) -> Exit:
    """Change settings."""
    wanted = parse_assignments(arguments.assignments)
    with open_commissioning(arguments) as commissioning:
        cells = read_cells(commissioning, arguments, to_read(wanted), to_write=True)
        check_margins(arguments.scenario, cells, [wanted] * len(cells))
        changes = [change for cell in cells for change in cell.changes(wanted)]
        node_ids = [cell.node_id for cell in cells]
        if not arguments.json:
            show_changes(changes)
        write_cells(commissioning, changes, node_ids, save=arguments.save)
    if arguments.json:
        print(json.dumps({"changes": list(map(_change, changes)), "saved": arguments.save}))
    else:
        print(_verdict(changes, node_ids, saved=arguments.save))
    return Exit.OK


def check_margins(
    scenario: str,
    cells: Sequence[CellSettings],
    wanted: Sequence[Mapping[Parameter, int]],
) -> None:
    """Raises `CommandError` (bad input) for settings that leave a speed loop no margin.

    `wanted` has what each cell is to be given; only loops that it changes are looked at, with the
    motor of the scenario.
    """
    loops = {
        tuple(node.after[each] for each in loop)
        for node in map(_After, cells, wanted)
        for loop in ([BY_NAME[name] for name in names] for names in LOOPS)
        if any(map(node.changes, loop))
    }
    if loops:
        _check_loops(scenario, loops)


class _After:
    """A cell's settings as they will be."""

    def __init__(self, cell: CellSettings, wanted: Mapping[Parameter, int]) -> None:
        self._before = cell.values
        self.after = {**cell.values, **wanted}

    def changes(self, parameter: Parameter) -> bool:
        return self.after.get(parameter) != self._before.get(parameter)


def _check_loops(scenario: str, loops: set[tuple[int, ...]]) -> None:
    motor = motor_of(load_scenario(scenario).cell)
    if motor.mass_kg == 0.0:
        say(f"mdms: the motors of {scenario} have no inertia, so no gain is too large for them")
        return
    gain, lag, feed = (BY_NAME[name] for name in LOOPS[0])
    for numbers in sorted(loops):
        gain_vs_per_m, lag_s, acceleration = (
            float(each.decimal(number))
            for each, number in zip((gain, lag, feed), numbers, strict=True)
        )
        try:
            check_gain(motor, gain_vs_per_m, Observer(lag_s, acceleration))
        except GainError as error:
            raise CommandError(
                f"{error} (motor of {scenario}, observer lag {lag.text(numbers[1])}, "
                f"acceleration per volt {feed.text(numbers[2])}); name your motors with --scenario",
                Exit.USAGE,
            ) from None


def to_read(wanted: Mapping[Parameter, int]) -> list[Parameter]:
    """What is to be changed, and what the margin of its speed loop depends on besides."""
    needed = dict.fromkeys(wanted)
    for names in LOOPS:
        if any(BY_NAME[name] in wanted for name in names):
            needed.update(dict.fromkeys(BY_NAME[name] for name in names))
    return list(needed)


def _change(change: Change) -> dict[str, object]:
    parameter = change.parameter
    return {
        "node": change.node_id,
        "name": parameter.name,
        "before": parameter.si(change.before),
        "after": parameter.si(change.after),
    }


def _verdict(changes: Sequence[Change], node_ids: Sequence[int], *, saved: bool) -> str:
    done = f"{len(changes)} settings written and verified" if changes else "nothing to change"
    return f"{done}; stored on node {ranges(node_ids)}" if saved else done
