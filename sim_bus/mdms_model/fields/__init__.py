"""Open-loop velocity fields: the reference of every wheel, from its place and direction alone."""
