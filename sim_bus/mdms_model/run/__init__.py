"""What a run leaves behind: the record, its file, its folder, its tables."""
