"""The verb `flash`."""
