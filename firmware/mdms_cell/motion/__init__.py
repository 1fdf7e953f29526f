"""Where a parcel is to go, and what the cell's wheels do for it."""
