"""Verbs that simulate, and verbs about the run folders they leave."""
