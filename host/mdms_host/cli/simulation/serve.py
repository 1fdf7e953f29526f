"""`mdms serve`: the virtual array in real time, for other programs."""

import os
from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, nullcontext
from functools import partial
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from mdms_array.extras import PAGE, require
from mdms_array.figures import simulated_run
from mdms_array.host import layout_of
from mdms_array.recording import HostLog, keep_run, lasting
from mdms_array.simulation import host_report_of
from mdms_array.source import open_program
from mdms_host.can_link.bus_log import is_from_host, open_log
from mdms_host.cli.exits import CommandError, ExitCode, has_arrived, interrupted
from mdms_host.cli.files import writing, written
from mdms_host.cli.kept import Kept, check_log, keeping, keeps_frames, say_log_ends
from mdms_host.cli.line import Job, has_line, made_folder, recipes_of
from mdms_host.cli.log_files import locked
from mdms_host.cli.streams import say
from mdms_host.clock import MonotonicClock
from mdms_host.line.machine import Recipes
from mdms_model.arrays import Floats
from mdms_model.errors import Error
from mdms_model.run.folder import BUS_LOG, check_other_run, fresh_folder
from mdms_model.run.record import MOST_SAMPLES
from mdms_model.scenario.belief import believed
from mdms_model.scenario.scenario import Scenario
from mdms_protocol.codecs.frame import Frame
from mdms_sim.nodes.bank import NodeError
from mdms_sim.nodes.kept_flash import KeptFlash
from mdms_sim.physics.plane.world import World
from mdms_sim.serve.server import Server, ways_in
from mdms_sim.simulation import NS_PER_S, Recording, Simulation, addresses_of, open_bank

if TYPE_CHECKING:
    from mdms_host.page.run_slot import RunSlot

#: The file of the stored settings in the folder `--state`.
STORED_CELLS, LOCK_OF_CELLS = "cells.json", ".cells.lock"
#: How often somebody looks whether a cell has stored something, in the table's time.
KEEP_NS = NS_PER_S


def run(arguments: Namespace) -> ExitCode:
    """Serve until Ctrl-C or SIGTERM; keep a run folder if asked to.

    A parcel that tips is taken off the table.
    """
    if arguments.page is not None:
        require(PAGE, "mdms serve --page")
    check_log(arguments)
    overrides = [*arguments.overrides, "run.fidelity=firmware"]
    scenario, main = open_program(arguments.scenario, overrides)
    recipes = recipes_of(arguments, arguments.scenario, (scenario, main), overrides)
    if arguments.out is not None and not arguments.force:
        check_other_run(arguments.out, None)
    attended = arguments.page is not None or has_line(arguments)
    slot = _slot(recipes) if attended else None
    # Programs from elsewhere keep their own beliefs.
    host = HostLog(scenario, lambda: slot.coordinator if slot else None)
    told = believed(scenario)
    with _kept_flash(scenario, arguments) as stored:
        try:
            with keeping(scenario, layout_of(told), arguments, main=main) as kept:
                kept.run_by(recipes.jobs, lambda: recipes.running)
                if arguments.out is None:
                    _, ended_by = _serve(recipes, slot, host, arguments, kept=kept, stored=stored)
                else:
                    ended_by = _serve_and_keep(
                        recipes, slot, host, arguments, kept=kept, stored=stored
                    )
                if ended_by is not None:
                    raise ended_by
        except KeyboardInterrupt:
            # The usual end of a service, and the loss of a run folder that is not written yet.
            if arguments.out is not None:
                raise
            has_arrived()
    return ExitCode.OK


@contextmanager
def _kept_flash(scenario: Scenario, arguments: Namespace) -> Iterator[KeptFlash | None]:
    """The flash of the cells as `--state` keeps it. Either kind of cell continues it.

    Raises `InputError` and `CommandError`.
    """
    if arguments.state is None:
        yield None
        return
    path = made_folder(arguments) / STORED_CELLS
    lock = locked(path.parent, LOCK_OF_CELLS, "--state")
    try:
        try:
            stored = KeptFlash(path, scenario.array.columns * scenario.array.rows)
        except OSError as error:
            told = f"{path}: cannot be read: {error.strerror}"
            raise CommandError(told, ExitCode.USAGE) from None
        try:
            yield stored
        finally:
            with writing(path):
                stored.keep()
    finally:
        os.close(lock)


class _Watch:
    """Looks after a served simulation: reports parcels that tip, and keeps what cells store.

    `over` tells whether the service is over.
    """

    def __init__(
        self,
        simulation: Simulation,
        stored: KeptFlash | None,
        over: Callable[[], object],
        report: Callable[[str], object],
    ) -> None:
        self._simulation = simulation
        self._stored = stored
        self._over = over
        self._report = report
        self._seen = 0
        self._look_ns = 0

    def __call__(self) -> object:
        """Whether the service is over. Raises `CommandError` if the state cannot be written."""
        events = self._simulation.world.events
        for event in events[self._seen :]:
            if event.kind == "tip":
                self._report(
                    f"mdms: {event.parcel} tips at {event.time_s:.3f} s and is taken off the table:"
                    f" {event.detail}"
                )
        self._seen = len(events)
        now_ns = self._simulation.kernel.now_ns
        if self._stored is not None and now_ns >= self._look_ns:
            self._look_ns = now_ns + KEEP_NS
            with writing(self._stored.path):
                self._stored.keep()
        return self._over()


def _serve_and_keep(
    recipes: Recipes[Job],
    slot: "RunSlot | None",
    host: HostLog,
    arguments: Namespace,
    *,
    kept: Kept,
    stored: KeptFlash | None,
) -> Exception | None:
    """Serve to the end and keep the run; return the error that has ended it, None for none."""
    clock, (scenario, _) = MonotonicClock(), recipes.first
    with ExitStack() as filled:
        folder = filled.enter_context(fresh_folder(arguments.out))
        all_frames = keeps_frames(arguments)
        failed = say_log_ends(arguments.out)
        with open_log(folder / BUS_LOG, failed) if all_frames else nullcontext() as log:
            simulation, ended_by = _serve(
                recipes, slot, host, arguments, kept=kept, stored=stored, log=log
            )
            outcome = simulation.outcome()
        host.add_to(outcome.record)
        lasted = lasting(scenario, float(outcome.record.time_s[-1]))
        ended = simulated_run(
            lasted,
            outcome.record,
            nodes=arguments.nodes,
            bus=outcome.bus,
            violations=outcome.violations,
            wall_s=clock.now_s(),
        )
        figures = {**ended.figures, "run": str(arguments.out)}
        # No seed repeats what other programs and people did.
        del figures["seed"]
        keep = partial(keep_run, folder, lasted, outcome.record, figures)
        incomplete = written(arguments.out, keep, filled.close)
    if incomplete is None or ended_by is None:
        return ended_by or incomplete
    say(f"mdms: {incomplete}")
    return ended_by


def _serve(
    recipes: Recipes[Job],
    slot: "RunSlot | None",
    host: HostLog,
    arguments: Namespace,
    *,
    kept: Kept,
    stored: KeptFlash | None,
    log: BinaryIO | None = None,
) -> tuple[Simulation, Exception | None]:
    """Serve to the end; recorded where there is a run folder, in a bounded memory.

    The second is the error that has ended a table that was served, None for a usual end.
    """
    scenario, _ = recipes.first
    ended_by: Exception | None = None
    is_served = False
    cells = scenario.array.columns * scenario.array.rows
    flash = None if stored is None else stored.flash
    with closing(open_bank(arguments.nodes, addresses_of(scenario).node_ids, flash)) as bank:

        def estimates() -> Floats:
            return host.sample(simulation.kernel.now_ns / NS_PER_S)

        simulation = Simulation(
            scenario,
            bank,
            [slot] if slot else [],
            recording=None if arguments.out is None else Recording(log, estimates, MOST_SAMPLES),
            host_report=(lambda: host_report_of(slot.coordinator)) if slot else None,
            beyond_tipping=True,
        )
        name = arguments.name or _name_of(arguments.scenario)

        def report(text: str) -> None:
            say(text)
            kept.event(simulation.kernel.now_ns / NS_PER_S, "serve", text)

        try:
            with ExitStack() as opened:
                server = opened.enter_context(
                    Server(simulation, name, arguments.tcp, arguments.speed, report=report)
                )
                _keep_frames(simulation, kept)
                pressed = opened.enter_context(interrupted(kept.on_hangup))
                over: Callable[[], object] = pressed
                if slot:
                    # The page is an extra.
                    from mdms_host.cli.simulation.live import attended  # noqa: PLC0415

                    over = opened.enter_context(
                        attended(
                            scenario, slot, server, arguments, recipes=recipes, over=over, kept=kept
                        )
                    )
                over = _kept(server, kept, over)
                buses = len(server.all_addresses)
                where = "a virtual CAN bus" if buses == 1 else f"{buses} virtual CAN buses"
                print(f"{scenario.title}: {cells} cells on {where}; connect with")
                for addresses in server.all_addresses:
                    print(*(f"  {line}" for line in ways_in(addresses)), sep="\n", flush=True)
                is_served = True
                server.run(_Watch(simulation, stored, over, report))
        except (Error, CommandError) as error:
            if not is_served:
                raise
            ended_by = error
            if isinstance(error, NodeError):
                kept.after_fault(simulation.kernel.now_ns / NS_PER_S, str(error))
    return simulation, ended_by


def _keep_frames(simulation: Simulation, kept: Kept) -> None:
    """Have the frames of all buses kept; those of a host are known by their identifiers."""
    recent = kept.recent
    if recent is None:
        return

    def observer(bus: int) -> Callable[[Frame, int], None]:
        def on_frame(frame: Frame, now_ns: int) -> None:
            keep = recent.on_sent if is_from_host(frame.can_id) else recent.on_received
            keep(frame, now_ns / NS_PER_S, bus)

        return on_frame

    for number, bus in enumerate(simulation.buses):
        bus.observe(observer(number))


def _kept(server: Server, kept: Kept, over: Callable[[], object]) -> Callable[[], object]:
    """`over`, which also looks after `kept` at each call."""
    kernel, world = server.simulation.kernel, server.simulation.world

    def looked() -> object:
        now_ns, recent = kernel.now_ns, kept.recent
        now_s = now_ns / NS_PER_S
        if recent is not None:
            recent.on_cycle(max(0.0, server.time.sim_ns(now_ns) / NS_PER_S - now_s))
            if recent.wants_truth(now_s):
                recent.see(now_s, _true_poses(world))
        kept.attend(now_s)
        return over()

    return looked


def _true_poses(world: World) -> Floats:
    """The poses of the parcels (P, 3), NaN for those that are not on the table."""
    states = world.scene.state.parcels
    there = (states["lifted"] == 0) & (states["away"] == 0)
    poses: Floats = np.where(there[:, None], world.pose, np.nan)
    return poses


def _slot(recipes: Recipes[Job]) -> "RunSlot":
    from mdms_host.cli.simulation.live import slot_of  # noqa: PLC0415

    return slot_of(*recipes.first, recipes)


def _name_of(scenario: str) -> str:
    """The channel for a scenario: its name, or its file's."""
    return scenario.rsplit("/", 1)[-1].removesuffix(".toml").removesuffix(".py")
