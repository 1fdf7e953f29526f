"""One cell on its way up: identity, settings, drives."""
