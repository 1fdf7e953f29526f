"""Parcels are searched for where sensors are covered."""
