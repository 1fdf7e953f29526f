"""A run as a scene for the 3D panels of Foxglove and Lichtblick: each kind of thing a topic."""
