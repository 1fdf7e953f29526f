"""From believed poses to the references of all wheels."""
