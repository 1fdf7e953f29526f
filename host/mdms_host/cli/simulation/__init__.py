"""Verbs that simulate, once or many times, and verbs about the run folders they leave."""
