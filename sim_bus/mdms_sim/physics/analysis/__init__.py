"""Effects of fields on parcels: forces, equilibria, reduced laws."""
