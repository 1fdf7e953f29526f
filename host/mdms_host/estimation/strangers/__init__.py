"""What lies on the table and is no parcel that was given."""
