"""Routes for all parcels at once, in which no two are ever on one tile of the table."""
