"""The results of a run: the record, its file, its folder, its tables."""
