"""A run of the array: bring-up, setpoints in step with SYNC, supervision, an orderly end."""
