"""What parcels look like from above, and what is asked of an outline."""
