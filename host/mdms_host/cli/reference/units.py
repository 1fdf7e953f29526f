"""Units, by the endings of the names that carry them."""

#: Ending of a name and the unit, longer endings before those that they end with.
UNITS = (
    ("_kg_m2", "kg m2"),
    ("_nm_per_a", "N m/A"),
    ("_vs_per_m", "V s/m"),
    ("_s_per_m", "s/m"),
    ("_rad_s2", "rad/s2"),
    ("_rad_s", "rad/s"),
    ("_m_s2", "m/s2"),
    ("_m_s", "m/s"),
    ("_per_s", "1/s"),
    ("_n_s", "N s"),
    ("_nms", "N m s"),
    ("_ohm", "ohm"),
    ("_ppm", "ppm"),
    ("_deg", "degrees"),
    ("_rad", "rad"),
    ("_kg", "kg"),
    ("_mm", "mm"),
    ("_ms", "ms"),
    ("_ns", "ns"),
    ("_m2", "m2"),
    ("_m", "m"),
    ("_s", "s"),
    ("_n", "N"),
    ("_v", "V"),
    ("_a", "A"),
)


def unit_of(name: str) -> str:
    """The unit that a name ends with; empty for a name without one."""
    return next((unit for ending, unit in UNITS if name.endswith(ending)), "")
