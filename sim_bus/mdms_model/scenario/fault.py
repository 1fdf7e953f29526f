"""The faults of a scenario: on the wire, at the nodes, in the world."""

from dataclasses import dataclass, field

from mdms_model.scenario.limit import ANGLE, PLACE, Limit

IMPULSE = Limit(at_least=-1e6, at_most=1e6)
FAULTS = (
    *("loss", "corruption", "overload", "delay", "babble", "cut"),
    *("off", "hang", "drift", "host", "supply", "bridge_fault"),
    *("sensor_stuck", "encoder_stuck", "wheel_jammed", "motor_reversed", "push", "lift"),
    "wrong_place",
)


@dataclass(frozen=True, slots=True)
class Fault:
    """Something that goes wrong from `start_s` on, for `duration_s` (None: for good).

    `cells` have it, numbered from 1; empty means all, and where frames are concerned everybody
    else on the bus too. `bus`, from 0, confines faults of frames, and a host's, to one of several
    buses; None means all. `axes` are numbered from 1 and `sensors` from 0; empty means all. By
    kind:

    - loss: their frames get lost on the way to `seen_by` (empty: to all) with `probability`
    - corruption: a bit of their frames, any from the first to the second after the frame, is read
      wrong by `seen_by` (empty: by all) with `probability`
    - overload: after any frame they hold up the next by `overload_frames` with `probability`
    - delay: their frames leave `delay_s` late
    - babble: they send frames with `can_id` every `period_s`, besides all else
    - cut: the wire is cut between them and the rest
    - off: they lose power, and start again at the end, as `node_id` if that is given
    - hang: their program stops, and the watchdog resets them at the end
    - drift: their clock is fast by `drift_ppm`
    - supply: the supply of their motors is `supply_v`, 0 behind an emergency stop; with `brake` its
      contacts short the motors too, and without it the wheels coast below 4.5 V
    - bridge_fault: their bridges report a fault and have shut off
    - sensor_stuck: their presence `sensors` read `covered`, or free, in any case
    - encoder_stuck: the encoders of their `axes` count no more
    - wheel_jammed: the wheels of their `axes` stand at any voltage
    - motor_reversed: the motors of their `axes` turn the other way, their encoders count as ever
    - push: `parcel` gets an impulse through its centre of mass, and one about it [table frame]
    - lift: `parcel` is off the table, and at rest where it was, or at `x_m`, `y_m` and `yaw_rad` as
      far as they are given, at the end
    - host: the coordinator neither receives nor sends, on its `bus` if that is given
    - wrong_place: `cells` names one cell; it and `as_cell` are in each other's places, under their
      own node ids
    """

    kind: str = field(metadata=Limit(choices=FAULTS))
    """What goes wrong."""
    start_s: float = field(default=0.0, metadata=Limit(at_least=0.0, at_most=1e5))
    """When it begins."""
    duration_s: float | None = field(default=None, metadata=Limit(above=0.0, at_most=1e5))
    """How long it lasts; none: for good."""
    cells: tuple[int, ...] = field(default=(), metadata=Limit(at_least=1, at_most=1_000_000))
    """Numbers of the cells that have it; none: all."""
    bus: int | None = field(default=None, metadata=Limit(at_least=0, at_most=1_000_000))
    """The bus of a fault of frames, or of the host, from 0; none: all."""
    seen_by: tuple[int, ...] = field(default=(), metadata=Limit(at_least=1, at_most=1_000_000))
    """Numbers of the cells that receive loss or corruption; none: all."""
    probability: float = field(default=1.0, metadata=Limit(at_least=0.0, at_most=1.0))
    """Probability for each frame of loss, corruption and overload."""
    delay_s: float = field(default=0.001, metadata=Limit(at_least=0.0, at_most=10.0))
    """How late frames leave, of delay."""
    can_id: int = field(default=0, metadata=Limit(at_least=0, at_most=0x7FF))
    """Identifier of the frames of babble."""
    period_s: float = field(default=0.0001, metadata=Limit(at_least=0.00001, at_most=1000.0))
    """Time between the frames of babble."""
    node_id: int | None = field(default=None, metadata=Limit(at_least=1, at_most=127))
    """Node id after off; none: the same as before."""
    overload_frames: int = field(default=1, metadata=Limit(at_least=1, at_most=2))
    """Overload frames after each frame, of overload."""
    supply_v: float = field(default=0.0, metadata=Limit(at_least=0.0, at_most=60.0))
    """Supply of the motors, of supply; 0: an emergency stop."""
    brake: bool = False
    """Whether the motors are shorted, of supply, whatever `supply_v` is."""
    drift_ppm: int = field(default=0, metadata=Limit(at_least=-500_000, at_most=500_000))
    """How much the clock is fast, of drift."""
    sensors: tuple[int, ...] = field(default=(), metadata=Limit(at_least=0, at_most=4))
    """Sensors of sensor_stuck, from 0; none: all."""
    covered: bool = True
    """What sensors of sensor_stuck report."""
    axes: tuple[int, ...] = field(default=(), metadata=Limit(at_least=1, at_most=2))
    """Axes of encoder_stuck, wheel_jammed and motor_reversed; none: both."""
    parcel: str = ""
    """Name of the parcel of push and lift."""
    impulse_n_s: tuple[float, float] = field(default=(0.0, 0.0), metadata=IMPULSE)
    """Impulse of push through the centre of mass, along x and y."""
    twist_nms: float = field(default=0.0, metadata=IMPULSE)
    """Angular impulse of push about the centre of mass."""
    as_cell: int | None = field(default=None, metadata=Limit(at_least=1, at_most=1_000_000))
    """The cell whose place is taken, of wrong_place."""
    x_m: float | None = field(default=None, metadata=PLACE)
    """Place along x where a lifted parcel is set down; none: where it was."""
    y_m: float | None = field(default=None, metadata=PLACE)
    """The same along y."""
    yaw_rad: float | None = field(default=None, metadata=ANGLE)
    """Its angle there; none: as it was."""
