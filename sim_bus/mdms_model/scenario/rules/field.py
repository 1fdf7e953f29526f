"""Rules of fields and their parts: made of something, in regions that have an area."""

from collections.abc import Sequence
from itertools import combinations

from mdms_model.scenario.motion import COMPOSED, Motion, Part, Region
from mdms_model.scenario.scenario import Scenario, ScenarioError

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
