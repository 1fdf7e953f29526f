"""The parcel that a cell belongs to, and the parcel that it is promised to."""
