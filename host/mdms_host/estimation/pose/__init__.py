"""Where one parcel is and how it moves."""
