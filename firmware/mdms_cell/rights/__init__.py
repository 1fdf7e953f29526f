"""Which parcel a cell belongs to, and whom it is promised to."""
