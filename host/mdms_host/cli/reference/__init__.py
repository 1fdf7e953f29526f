"""Pages of `docs/` that are made of the code: keys of scenarios and programs, names of the API."""
