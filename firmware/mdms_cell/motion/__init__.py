"""The goal of a parcel, and the part of the cell's wheels in the way to it."""
