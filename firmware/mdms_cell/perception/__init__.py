"""What a cell believes of the parcel over it: from wheels, sensors, and what neighbours say."""
