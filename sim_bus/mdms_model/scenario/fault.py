"""What a scenario lets go wrong: on the wire, at the nodes, in the world."""

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
    - overload: after a frame, of whomever, they hold up the next by `overload_frames` with
      `probability`
    - delay: their frames leave `delay_s` late
    - babble: they send frames with `can_id` every `period_s`, besides what they do else
    - cut: the wire is cut between them and the rest
    - off: they lose power, and start again at the end, as `node_id` if that is given
    - hang: their program stops, and the watchdog resets them at the end
    - drift: their clock is fast by `drift_ppm`
    - supply: the supply of their motors is `supply_v`, 0 behind an open emergency stop
    - bridge_fault: their bridges report a fault and have shut off
    - sensor_stuck: their presence `sensors` read `covered`, or free, whatever lies over them
    - encoder_stuck: the encoders of their `axes` count no more
    - wheel_jammed: the wheels of their `axes` stand, whatever the voltage
    - motor_reversed: the motors of their `axes` turn the other way, their encoders count as ever
    - push: `parcel` gets an impulse through its centre of mass, and one about it [table frame]
    - lift: `parcel` is off the table, and at rest where it was, or at `x_m`, `y_m` and `yaw_rad`
      as far as they are given, at the end
    - host: the coordinator neither receives nor sends, on its `bus` if that is given
    - wrong_place: the one of `cells` and `as_cell` are each where the other should be, and go on
      under their own node ids
    """

    kind: str = field(metadata=Limit(choices=FAULTS))
    start_s: float = field(default=0.0, metadata=Limit(at_least=0.0, at_most=1e5))
    duration_s: float | None = field(default=None, metadata=Limit(above=0.0, at_most=1e5))
    cells: tuple[int, ...] = field(default=(), metadata=Limit(at_least=1, at_most=1_000_000))
    bus: int | None = field(default=None, metadata=Limit(at_least=0, at_most=1_000_000))
    seen_by: tuple[int, ...] = field(default=(), metadata=Limit(at_least=1, at_most=1_000_000))
    probability: float = field(default=1.0, metadata=Limit(at_least=0.0, at_most=1.0))
    delay_s: float = field(default=0.001, metadata=Limit(at_least=0.0, at_most=10.0))
    can_id: int = field(default=0, metadata=Limit(at_least=0, at_most=0x7FF))
    period_s: float = field(default=0.0001, metadata=Limit(at_least=0.00001, at_most=1000.0))
    node_id: int | None = field(default=None, metadata=Limit(at_least=1, at_most=127))
    overload_frames: int = field(default=1, metadata=Limit(at_least=1, at_most=2))
    supply_v: float = field(default=0.0, metadata=Limit(at_least=0.0, at_most=60.0))
    drift_ppm: int = field(default=0, metadata=Limit(at_least=-500_000, at_most=500_000))
    sensors: tuple[int, ...] = field(default=(), metadata=Limit(at_least=0, at_most=4))
    covered: bool = True
    axes: tuple[int, ...] = field(default=(), metadata=Limit(at_least=1, at_most=2))
    parcel: str = ""
    impulse_n_s: tuple[float, float] = field(default=(0.0, 0.0), metadata=IMPULSE)
    twist_nms: float = field(default=0.0, metadata=IMPULSE)
    as_cell: int | None = field(default=None, metadata=Limit(at_least=1, at_most=1_000_000))
    x_m: float | None = field(default=None, metadata=PLACE)
    y_m: float | None = field(default=None, metadata=PLACE)
    yaw_rad: float | None = field(default=None, metadata=ANGLE)
