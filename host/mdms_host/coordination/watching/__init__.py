"""Reports of a run for a person: wheels that do not follow, parcels that do not get on."""
