"""A run as an MCAP file, for Foxglove, Lichtblick and PlotJuggler."""
