"""A cell's belief of the parcel over it: from wheels, sensors, and reports of neighbours."""
