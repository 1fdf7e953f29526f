"""Messages between cells: objects, frames, and frames as values."""
