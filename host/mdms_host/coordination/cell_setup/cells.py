"""The cells of a layout, each with the settings that it gets when it comes up."""

from collections.abc import Iterator, Mapping

from mdms_host.can_link.sdo_client import Setting
from mdms_host.coordination.cell_setup.bring_up import BringUpCell
from mdms_host.coordination.cell_setup.steering_settings import steering_settings
from mdms_host.layout import Layout
from mdms_host.places import Place, all_values
from mdms_protocol import indices
from mdms_protocol.entry import OutOfRangeError


def cells_of(
    layout: Layout,
    settings: tuple[Setting, ...],
    own_settings: Mapping[int, tuple[Setting, ...]],
    serials: Mapping[int, int],
    *,
    status_period_s: float,
    steered_beside: int | None,
    asks_boards: bool,
) -> tuple[BringUpCell, ...]:
    """All cells, cell 1 first; they steer beside the host of a node id, if that is given.

    `settings` are written to every cell, `own_settings` to the cell of that number besides;
    `serials` are those that cells must have, by number. With `asks_boards`, cells that steer are
    asked whether their board can. Raises `OutOfRangeError` for a place that
    does not fit the wire, where cells steer.
    """
    # Cells report their state on change, and repeat it, which makes up for a lost frame.
    repeat = Setting(indices.TPDO_PARAMETERS + 1, 5, round(status_period_s * 1e3))
    steers = steered_beside is not None
    # Last, so that a cell steers with its place only.
    steering = () if steered_beside is None else steering_settings(steered_beside)
    addresses = zip(layout.buses, layout.node_ids, strict=True)
    return tuple(
        BringUpCell(
            number,
            node_id,
            len(layout.wheels),
            (
                repeat,
                *settings,
                *(_placing(layout, number) if steers else ()),
                *own_settings.get(number, ()),
                *steering,
            ),
            spare={} if steers else _spare(layout, number),
            serial=serials.get(number),
            bus=bus if layout.bus_count > 1 else None,
            steers=steers,
            asks_board=steers and asks_boards,
        )
        for number, (bus, node_id) in enumerate(addresses, 1)
    )


def _placing(layout: Layout, number: int) -> Iterator[Setting]:
    """Settings of a cell's place. Raises `OutOfRangeError`."""
    for place, value in all_values(layout, number).items():
        yield Setting(*place, value)


def _spare(layout: Layout, number: int) -> dict[Place, int]:
    """Settings of its place that a cell may have; none if the place does not fit the wire."""
    try:
        return all_values(layout, number)
    except OutOfRangeError:
        return {}
