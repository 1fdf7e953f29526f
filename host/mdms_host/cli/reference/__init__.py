"""Pages of `docs/` that are made of the code: keys of scenarios and of programs."""
