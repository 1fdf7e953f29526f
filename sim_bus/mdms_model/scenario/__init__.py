"""What an experiment is: its values, its file, its rules."""
