"""Parcels on wheels in the plane, moved step by step."""
