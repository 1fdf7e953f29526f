"""Things on the table that are no given parcels."""
