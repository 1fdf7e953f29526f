"""Safe-interval path planning over a roadmap."""
