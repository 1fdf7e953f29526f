"""What a person should learn of a run: wheels that do not follow, parcels that do not get on."""
