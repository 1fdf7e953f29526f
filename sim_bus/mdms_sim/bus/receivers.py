"""Who hears which identifier, remembered so that a frame costs only those that it concerns."""

from collections.abc import Sequence

from mdms_sim.bus.controller import Controller

#: A flood of identifiers costs time, not memory.
REMEMBERED = 4096


class Receivers(dict[int, tuple[Controller, ...]]):
    """The controllers of a wire by identifier; `clear` it when any of them has changed."""

    def __init__(self, controllers: Sequence[Controller]) -> None:
        super().__init__()
        self._controllers = controllers

    def __missing__(self, can_id: int) -> tuple[Controller, ...]:
        if len(self) >= REMEMBERED:
            self.clear()
        self[can_id] = receivers = tuple(
            each
            for each in self._controllers
            if each.live and (each.accept is None or can_id in each.accept)
        )
        return receivers
