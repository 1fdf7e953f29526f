"""Rules of streams and exits, by their parcels and their table."""

from collections.abc import Iterable

from mdms_model.scenario.rules.on_table import check_over, half_table_m
from mdms_model.scenario.scenario import Scenario, ScenarioError
from mdms_model.scenario.stream import Exit


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
