"""The virtual CAN bus."""
