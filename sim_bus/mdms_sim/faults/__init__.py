"""What goes wrong in a scenario, by schedule and by chance."""
