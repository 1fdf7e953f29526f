"""The neighbour layer: the cells under a parcel drive it together, by messages among themselves."""
