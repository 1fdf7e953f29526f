"""Rules of the events of a run: fields, tasks, streams, faults, by table and parcels."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from math import hypot

from mdms_model.buses import address_cells
from mdms_model.outline import outline_of
from mdms_model.scenario.fault import Fault
from mdms_model.scenario.motion import COMPOSED, Motion, Part, Region
from mdms_model.scenario.scenario import (
    Exit,
    Parcel,
    Scenario,
    ScenarioError,
    Task,
    in_stock,
    name_fault,
)


def half_table_m(scenario: Scenario) -> tuple[float, float]:
    """How far the table reaches from its centre along x and y [m]."""
    array = scenario.array
    return array.columns * array.pitch_m / 2, array.rows * array.pitch_m / 2


def check_over(key: str, name: str, value: float, place_m: float, half_m: float) -> None:
    """Refuse the `value` of a key that puts the thing of that name off the table."""
    if abs(place_m) > half_m:
        raise ScenarioError(
            f"{key} is {value}, which puts {name} off the table; "
            f"the table reaches from {-half_m:g} to {half_m:g} m"
        )


Point = tuple[float, float]


def check_field(scenario: Scenario) -> None:
    """Refuse a field that its keys do not make. Raises `ScenarioError` with the key's full path."""
    motion = scenario.motion
    if motion.field in ("goal", "program"):
        _check_goal(motion)
    else:
        _check_part(motion, "motion")
        _check_policy(scenario)


def _check_goal(motion: Motion) -> None:
    """Steering has limits of its own and asks for surface speeds as it is."""
    given = {
        "policy": motion.policy is not None,
        "compensate_droop": motion.compensate_droop,
        "region": motion.region is not None,
        "part": bool(motion.part),
    }
    for name, is_given in given.items():
        if is_given:
            raise ScenarioError(
                f"motion.{name} is for open-loop fields, but motion.field is {motion.field!r}; "
                "leave it out"
            )


def _check_policy(scenario: Scenario) -> None:
    motion, cell = scenario.motion, scenario.cell
    if motion.policy is not None and cell.viscous_friction_s_per_m > 0.0:
        raise ScenarioError(
            f"motion.policy is {motion.policy!r}, whose limits are of Coulomb friction, but "
            f"cell.viscous_friction_s_per_m is {cell.viscous_friction_s_per_m}; leave one out"
        )


def _check_part(part: Part, key: str) -> None:
    if part.region is not None:
        _check_region(part.region, f"{key}.region")
    if part.field == "lane" and part.width_m is None:
        raise ScenarioError(f"{key}.field is 'lane', which needs {key}.width_m; give it a number")
    if part.field not in COMPOSED:
        if part.part:
            raise ScenarioError(
                f"{key}.part is given, but {key}.field is {part.field!r}, which has no parts; "
                f"set it to {' or '.join(map(repr, COMPOSED))}"
            )
        return
    if not part.part:
        raise ScenarioError(
            f"{key}.field is {part.field!r}, but it has no parts; list them in [[{key}.part]]"
        )
    for number, inner in enumerate(part.part):
        _check_part(inner, f"{key}.part.{number}")
        if part.field == "regions" and inner.region is None and inner is not part.part[-1]:
            raise ScenarioError(
                f"{key}.part.{number} has no region, so that no part after it ever holds; "
                "give it one, or put it last"
            )


def _check_region(region: Region, key: str) -> None:
    corners = region.corners_m
    if region.shape == "disc":
        if region.radius_m is None:
            raise ScenarioError(f"{key}.radius_m is missing; give it a number")
        if corners:
            raise ScenarioError(f"{key}.corners_m is given, but a disc has none; leave it out")
        return
    if region.radius_m is not None or region.centre_m != (0.0, 0.0):
        raise ScenarioError(
            f"{key}.centre_m and {key}.radius_m are for a disc, but {key}.shape is "
            f"{region.shape!r}; give it corners_m alone"
        )
    if region.shape == "rectangle":
        if len(corners) != 2 or any(a == b for a, b in zip(*corners, strict=True)):
            raise ScenarioError(
                f"{key}.corners_m must be two opposite corners of a rectangle, as in "
                f"[[-0.3, -0.1], [0.0, 0.1]]; got {_shown(corners)}"
            )
    elif len(corners) < 3 or not _is_simple(corners):
        raise ScenarioError(
            f"{key}.corners_m must be three corners or more of a polygon whose sides do not "
            f"cross; got {_shown(corners)}"
        )


def _shown(corners: Sequence[Point]) -> str:
    return str([list(corner) for corner in corners])


def _is_simple(corners: Sequence[Point]) -> bool:
    """Whether a polygon has an area, and sides that meet at their corners only."""
    sides = list(zip(corners, (*corners[1:], corners[0]), strict=True))
    area = sum(a[0] * b[1] - b[0] * a[1] for a, b in sides)
    if len(set(corners)) < len(corners) or area == 0.0:
        return False
    count = len(sides)
    pairs = combinations(range(count), 2)
    return not any(_cross(sides[i], sides[j]) for i, j in pairs if j - i not in (1, count - 1))


def _cross(one: tuple[Point, Point], other: tuple[Point, Point]) -> bool:
    """Whether two segments that are not neighbours meet."""
    apart = _side(*one, other[0]) * _side(*one, other[1])
    astride = _side(*other, one[0]) * _side(*other, one[1])
    return apart <= 0.0 and astride <= 0.0 and (apart < 0.0 or astride < 0.0)


def _side(start: Point, end: Point, point: Point) -> float:
    """Twice the area of a triangle, with the sign of its turn."""
    along, across = end[0] - start[0], end[1] - start[1]
    return along * (point[1] - start[1]) - across * (point[0] - start[0])


#: The necessary and the optional keys of each kind of task.
NEEDED: Mapping[str, tuple[str, ...]] = {
    "transport": ("parcel", "x_m", "y_m"),
    "name": ("parcel", "x_m", "y_m"),
    "swap": ("parcels",),
    "sort": (),
    "merge": ("exit",),
    "singulate": ("exit",),
    "buffer": ("exit", "places"),
    "wait": ("period_s",),
}
ALLOWED: Mapping[str, tuple[str, ...]] = {
    "transport": ("yaw_rad",),
    "name": ("length_m", "width_m", "mass_kg", "shape", "kind"),
    "swap": (),
    "sort": ("count",),
    "merge": ("count",),
    "singulate": ("period_s", "count"),
    "buffer": ("order", "count"),
    "wait": (),
}
_EMPTY = {item.name: item.default for item in dataclasses.fields(Task)}


def check_tasks(scenario: Scenario) -> None:
    """Refuse tasks that cannot be done. Raises `ScenarioError` with the key's full path."""
    programmed = scenario.motion.field == "program"
    if scenario.task and not programmed:
        raise ScenarioError(
            f"task is given, but motion.field is {scenario.motion.field!r}; set it to 'program'"
        )
    if programmed and scenario.run.fidelity != "firmware":
        raise ScenarioError(
            f"motion.field is 'program', but run.fidelity is {scenario.run.fidelity!r}; "
            "a program needs the cells' sensors, so set run.fidelity to 'firmware'"
        )
    for number, task in enumerate(scenario.task):
        key = f"task.{number}"
        _check_keys(task, key)
        named = [each.parcel for each in scenario.task[:number] if each.do == "name"]
        _check_names(scenario, task, key, named)
        _check_order(scenario, task, key)
        _check_places(scenario, task, key)
        if task.beside and not number:
            raise ScenarioError(f"{key}.beside is true, but no task comes before it; leave it out")


def _check_keys(task: Task, key: str) -> None:
    needed, known = NEEDED[task.do], (*NEEDED[task.do], *ALLOWED[task.do])
    for name, empty in _EMPTY.items():
        given = getattr(task, name) != empty
        if name in needed and not given:
            raise ScenarioError(f"{key}.{name} is missing, which {task.do!r} needs")
        if given and name not in (*known, "do", "beside"):
            raise ScenarioError(
                f"{key}.{name} is given, but {task.do!r} has only {', '.join(known) or 'no keys'}"
            )


def _check_names(scenario: Scenario, task: Task, key: str, named: list[str]) -> None:
    """Parcels lie on the table, or have been `named` by a task before; exits are there."""
    lying = [each.name for each in scenario.parcel if each.name not in in_stock(scenario)]
    lying += named
    if task.do == "name" and (fault := name_fault(task.parcel)):
        raise ScenarioError(f"{key}.parcel is {task.parcel!r:.60}, but {fault}")
    names = [("parcel", task.parcel)] if task.parcel and task.do != "name" else []
    names += [(f"parcels.{item}", name) for item, name in enumerate(task.parcels)]
    for name, parcel in names:
        if parcel not in lying:
            raise ScenarioError(
                f"{key}.{name} is {parcel!r}, but must be a parcel that lies on the table: "
                f"{', '.join(lying) or 'there is none'}"
            )
    if task.do == "swap" and len(set(task.parcels)) != 2:
        raise ScenarioError(f"{key}.parcels is {list(task.parcels)}, but must be two parcels")
    exits = [each.name for each in scenario.exit]
    if task.exit and task.exit not in exits:
        raise ScenarioError(
            f"{key}.exit is {task.exit!r}, but must be one of {', '.join(exits) or 'exit: none'}"
        )
    if task.do == "sort":
        _check_sorted(scenario, key)


def _check_order(scenario: Scenario, task: Task, key: str) -> None:
    """Each item may come: it is a name or a kind of a parcel, or of a thing that a task names."""
    things = [(each.name, each.kind) for each in scenario.parcel]
    things += [(each.parcel, each.kind) for each in scenario.task if each.do == "name"]
    known = dict.fromkeys(word for thing in things for word in thing if word)
    for item, word in enumerate(task.order):
        if word not in known:
            raise ScenarioError(
                f"{key}.order.{item} is {word!r}, but must be the name or the kind of a parcel: "
                f"{', '.join(known) or 'there is none'}"
            )


def _check_sorted(scenario: Scenario, key: str) -> None:
    """Every kind that comes has an exit."""
    stock, sorted_ = in_stock(scenario), {kind for each in scenario.exit for kind in each.kinds}
    for parcel in scenario.parcel:
        if parcel.name in stock and parcel.kind not in sorted_:
            raise ScenarioError(
                f"{key} is to sort {parcel.name!r} by its kind, {parcel.kind!r}, but no exit has "
                "that kind; give it to one, as in exit.0.kinds"
            )


def _check_places(scenario: Scenario, task: Task, key: str) -> None:
    places = [(f"places.{item}", place) for item, place in enumerate(task.places)]
    if task.x_m is not None and task.y_m is not None:
        places = [("", (task.x_m, task.y_m))]
    for name, place in places:
        for axis, half_m in enumerate(half_table_m(scenario)):
            path = f"{key}.{name}.{axis}" if name else f"{key}.{'xy'[axis]}_m"
            check_over(path, "the place", place[axis], place[axis], half_m)
    for item, twice in enumerate(task.places):
        if twice in task.places[:item]:
            raise ScenarioError(
                f"{key}.places.{item} is {list(twice)} once more, but one parcel alone has room "
                "there; give each place once"
            )


def check_streams(scenario: Scenario) -> None:
    """Refuse what cannot come or go. Raises `ScenarioError` with the key's full path."""
    _check_fidelity(scenario)
    _check_stocks(scenario)
    half_x_m, half_y_m = half_table_m(scenario)
    for number, stream in enumerate(scenario.stream):
        what = "the place where its parcels are set down"
        check_over(f"stream.{number}.x_m", what, stream.x_m, stream.x_m, half_x_m)
        check_over(f"stream.{number}.y_m", what, stream.y_m, stream.y_m, half_y_m)
    _check_exits(scenario)


def _check_fidelity(scenario: Scenario) -> None:
    if (scenario.stream or scenario.exit) and scenario.run.fidelity != "firmware":
        key = "stream" if scenario.stream else "exit"
        raise ScenarioError(
            f"{key} is given, but run.fidelity is {scenario.run.fidelity!r}; parcels come and go "
            "only on cells that carry them, so set run.fidelity to 'firmware'"
        )


def _check_stocks(scenario: Scenario) -> None:
    """Each parcel of a stock exists, is in no other stock, and is steered to no goal of its own."""
    named = {parcel.name: parcel for parcel in scenario.parcel}
    taken: dict[str, str] = {}
    for number, stream in enumerate(scenario.stream):
        for item, name in enumerate(stream.parcels):
            key = f"stream.{number}.parcels.{item}"
            if name not in named:
                raise ScenarioError(
                    f"{key} is {name!r}, but must be the name of a parcel: {', '.join(named)}"
                )
            if name in taken:
                raise ScenarioError(f"{key} is {name!r}, which {taken[name]} is already")
            if named[name].goal is not None:
                raise ScenarioError(
                    f"{key} is {name!r}, which has a goal, but comes and goes; leave its goal out"
                )
            taken[name] = key


def _check_exits(scenario: Scenario) -> None:
    kinds = {parcel.kind for parcel in scenario.parcel if parcel.kind}
    names: set[str] = set()
    for number, each in enumerate(scenario.exit):
        key = f"exit.{number}"
        if not each.name.strip() or not each.name.isprintable() or each.name in names:
            raise ScenarioError(f"{key}.name is {each.name!r}, but must be a word of its own")
        names.add(each.name)
        if each.from_m >= each.to_m:
            raise ScenarioError(
                f"{key}.from_m is {each.from_m}, but must be less than {key}.to_m, {each.to_m}"
            )
        for item, kind in enumerate(each.kinds):
            if kind not in kinds:
                known = ", ".join(sorted(kinds)) or "there is none"
                raise ScenarioError(
                    f"{key}.kinds.{item} is {kind!r}, but must be the kind of a parcel: {known}"
                )
        _check_apart(key, each, scenario.exit[:number])


def _check_apart(key: str, one: Exit, others: Iterable[Exit]) -> None:
    for other in others:
        if one.side == other.side and one.from_m < other.to_m and other.from_m < one.to_m:
            raise ScenarioError(
                f"{key} overlaps exit {other.name!r} on the {one.side} side; give each its own "
                "stretch by from_m and to_m"
            )


#: What is of no single cell, and has no `cells`.
_OF_PARCELS = ("push", "lift")
_WITHOUT_CELLS = (*_OF_PARCELS, "host")
#: What may be on one bus alone.
_ON_A_BUS = ("loss", "corruption", "overload", "host")
#: A parcel that goes faster crosses a cell within a few steps of the physics.
PUSHED_MOST_M_S = 10.0


def check_faults(scenario: Scenario) -> None:
    """Refuse faults of missing cells, axes, sensors and parcels.

    Raises `ScenarioError` with the key's full path.
    """
    for number, fault in enumerate(scenario.fault):
        key = f"fault.{number}"
        _check_numbers(scenario, fault, key)
        if scenario.run.fidelity != "firmware":
            raise ScenarioError(
                f"{key} needs cells and a bus, which run.fidelity "
                f"{scenario.run.fidelity!r} has not; set run.fidelity to 'firmware'"
            )
        if fault.kind in _WITHOUT_CELLS and fault.cells:
            raise ScenarioError(
                f"{key}.cells has {fault.cells[0]}, but {fault.kind!r} is of no cell; leave it out"
            )
        _check_bus(scenario, fault, key)
        if fault.brake and fault.kind != "supply":
            raise ScenarioError(
                f"{key}.brake is true, but {fault.kind!r} shorts no motor; leave it out, or take "
                "kind 'supply'"
            )
        if fault.kind == "wrong_place":
            _check_place(scenario, fault, key)
        if fault.kind in _OF_PARCELS:
            _check_parcel(scenario, fault, key)


def _check_numbers(scenario: Scenario, fault: Fault, key: str) -> None:
    cells = scenario.array.columns * scenario.array.rows
    axes, sensors = len(scenario.cell.wheel), len(scenario.cell.sensor_offset_m)
    _check_most(f"{key}.cells", fault.cells, cells, f"the array has {cells} cells")
    _check_most(f"{key}.seen_by", fault.seen_by, cells, f"the array has {cells} cells")
    _check_most(f"{key}.axes", fault.axes, axes, f"a cell has {axes} wheels, numbered from 1")
    _check_most(
        f"{key}.sensors",
        fault.sensors,
        sensors - 1,
        f"a cell has {sensors} sensors, numbered from 0",
    )


def _check_bus(scenario: Scenario, fault: Fault, key: str) -> None:
    if fault.bus is None:
        return
    if fault.kind not in _ON_A_BUS:
        raise ScenarioError(
            f"{key}.bus is {fault.bus}, but {fault.kind!r} is of cells or parcels, wherever they "
            "are; leave it out"
        )
    buses = len(scenario.array.buses) or 1
    _check_most(f"{key}.bus", [fault.bus], buses - 1, f"buses are numbered 0 to {buses - 1}")


def _check_place(scenario: Scenario, fault: Fault, key: str) -> None:
    cells = scenario.array.columns * scenario.array.rows
    if len(fault.cells) != 1:
        raise ScenarioError(f"{key}.cells is {list(fault.cells)}, but must be one cell")
    if fault.as_cell is None or fault.as_cell == fault.cells[0]:
        raise ScenarioError(
            f"{key}.as_cell is {fault.as_cell}, but must be another cell than {fault.cells[0]}"
        )
    _check_most(f"{key}.as_cell", (fault.as_cell,), cells, f"the array has {cells} cells")
    node_ids = address_cells(cells, scenario.array.buses).node_ids
    if scenario.array.coded_places and node_ids[fault.as_cell - 1] == node_ids[fault.cells[0] - 1]:
        raise ScenarioError(
            f"{key}.as_cell is {fault.as_cell}, but that cell has node id "
            f"{node_ids[fault.as_cell - 1]} on its bus, as cell {fault.cells[0]} has: the code of "
            "its place fits both; take another cell"
        )


def _check_most(key: str, numbers: Iterable[int], most: int, there: str) -> None:
    highest = max(numbers, default=most)
    if highest > most:
        raise ScenarioError(f"{key} has {highest}, but {there}")


def _check_parcel(scenario: Scenario, fault: Fault, key: str) -> None:
    named = {parcel.name: parcel for parcel in scenario.parcel}
    if fault.parcel not in named:
        raise ScenarioError(
            f"{key}.parcel is {fault.parcel!r}, but must be one of {', '.join(named)}"
        )
    if fault.kind == "push":
        _check_push(named[fault.parcel], fault, key)
    else:
        _check_set_down(scenario, named[fault.parcel], fault, key)


def _check_push(parcel: Parcel, fault: Fault, key: str) -> None:
    if fault.duration_s is not None:
        raise ScenarioError(
            f"{key}.duration_s is {fault.duration_s}, but a push takes no time; leave it out"
        )
    if not (any(fault.impulse_n_s) or fault.twist_nms):
        raise ScenarioError(f"{key}.impulse_n_s is [0, 0], and {key}.twist_nms is 0; give either")
    speed_m_s = hypot(*fault.impulse_n_s) / parcel.mass_kg
    outline = outline_of(parcel)
    inertia_kg_m2 = parcel.inertia_kg_m2 or parcel.mass_kg * outline.moment_m2
    rim_m_s = abs(fault.twist_nms) / inertia_kg_m2 * outline.radius_m
    for name, given, gained_m_s in (
        ("impulse_n_s", list(fault.impulse_n_s), speed_m_s),
        ("twist_nms", fault.twist_nms, rim_m_s),
    ):
        if gained_m_s > PUSHED_MOST_M_S:
            raise ScenarioError(
                f"{key}.{name} is {given}, which makes {parcel.name!r} {gained_m_s:.3g} m/s "
                f"faster, but at most {PUSHED_MOST_M_S:g} m/s are allowed"
            )


def _check_set_down(scenario: Scenario, parcel: Parcel, fault: Fault, key: str) -> None:
    for name, half_m in zip(("x_m", "y_m"), half_table_m(scenario), strict=True):
        place_m = getattr(fault, name)
        if place_m is not None:
            check_over(f"{key}.{name}", f"{parcel.name!r}", place_m, place_m, half_m)
    if fault.duration_s is None and (fault.x_m, fault.y_m, fault.yaw_rad) != (None, None, None):
        raise ScenarioError(
            f"{key}.duration_s is missing, so {parcel.name!r} is never set down; "
            "give it, or leave out x_m, y_m and yaw_rad"
        )
