"""Programs whose parcels are steered by the cells: the host plans, and sends goals as ways free."""

from contextlib import closing

import numpy as np

import mdms_array as mdms
from mdms_array.host import coordinator_of
from mdms_model.scenario.file import load_scenario
from mdms_protocol import pdo
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.simulation import Simulation

BY_CELLS = ("motion.field='program'", "motion.control='cells'", "motion.speed_m_s=0.4")
PLATE = "mass_kg=1.0, length_m=0.28, width_m=0.28, y_m=0.0"
#: Each takes three columns of cells at its start and at its goal, and both need the fourth.
TWO = (
    *BY_CELLS,
    "array.columns=7",
    f"parcel=[{{name='one', x_m=-0.25, {PLATE}}}, {{name='two', x_m=0.13, {PLATE}}}]",
    "task=[{do='transport', parcel='one', x_m=-0.13, y_m=0.0, yaw_rad=0.0}, "
    "{do='transport', parcel='two', x_m=0.25, y_m=0.0, yaw_rad=0.0, beside=true}]",
)


def test_one_waits_until_the_other_has_left_a_cell_that_both_need() -> None:
    scenario = load_scenario("array18", [*TWO, "run.duration_s=6"])
    coordinator, setpoints = coordinator_of(scenario), []
    wanted = {pdo.TARGET_VELOCITY.can_id(node) for node in range(1, 22)}

    def watch(frame, now_ns):
        if frame.can_id in wanted:
            setpoints.append(frame)

    with closing(PythonBank(range(1, 22))) as bank:
        simulation = Simulation(scenario, bank, [coordinator])
        simulation.bus.observe(watch)
        for tenth in range(1, 60):
            simulation.run_until(tenth / 10)
            if coordinator.finished:
                break
        record = simulation.outcome().record
    assert coordinator.finished
    assert not coordinator.troubles
    assert not setpoints
    ends_m = record.pose[-1, :, 0] - (-0.13, 0.25)
    assert np.abs(ends_m).max() < 0.005
    assert not [event for event in record.events if event.kind == "touch"]
    # The last column of the one and the first of the other are never the same.
    one_m, two_m = record.pose[:, :, 0].T
    assert ((one_m + 0.14 < -0.0635) | (two_m - 0.14 > 0.0635)).all()


def test_a_thing_whose_size_is_only_measured_is_no_parcel_of_cells_for_they_learn_none() -> None:
    two = f"parcel=[{{name='one', x_m=-0.22, {PLATE}}}, {{name='two', x_m=0.2, {PLATE}}}]"
    unknown = "belief={two={known=false}}"
    refused = []

    async def name(table: mdms.Table) -> None:
        await table.sleep(0.5)
        for size in ((None, None), (0.20, 0.20), (0.45, 0.30)):
            try:
                await table.name(mdms.Newcomer("crate", *size), 0.2, 0.0)
            except mdms.ProgramError as error:
                refused.append(str(error))
        await table.name(mdms.Newcomer("crate", 0.28, 0.28), 0.2, 0.0)

    scenario = load_scenario("array18", [*BY_CELLS, two, unknown, "task=[]", "run.duration_s=4"])
    run = mdms.simulate(scenario, program=name)
    assert run.status == "reached"
    assert "its size is known within" in refused[0]
    assert "it is 0.2 m wide and 0.283 m across" in refused[1]
    assert "it is 0.3 m wide and 0.541 m across" in refused[2]
