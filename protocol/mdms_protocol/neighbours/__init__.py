"""What cells say to each other: objects, frames, and frames as values."""
