"""What a scenario's field tells the wheels."""

from mdms_host.command.exits import CommandError, Exit
from mdms_model import fields
from mdms_model.array import build_wheels
from mdms_model.arrays import Floats
from mdms_model.scenario.scenario import Scenario


def references_m_s(scenario: Scenario) -> Floats:
    """References of all wheels [m/s], shape (W,). Raises `CommandError` for a field's bad table."""
    motion = scenario.motion
    shape = fields.FieldShape(
        speed_m_s=motion.speed_m_s,
        heading_rad=motion.heading_rad,
        centre_m=motion.centre_m,
        velocity_m_s=motion.velocity_m_s,
        yaw_rate_rad_s=motion.yaw_rate_rad_s,
        ratio=motion.ratio,
        table_m_s=motion.table_m_s,
    )
    wheels = build_wheels(scenario)
    try:
        return fields.references_m_s(motion.field, wheels.position_m, wheels.direction, shape)
    except fields.FieldError as error:
        raise CommandError(f"motion.field: {error}", Exit.USAGE) from None
