"""The actions of `mdms configure`."""
