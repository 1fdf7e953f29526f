"""What is believed of the parcels, from presence bits and wheel speeds."""
