"""Settings of a cell that outlive the power supply."""
