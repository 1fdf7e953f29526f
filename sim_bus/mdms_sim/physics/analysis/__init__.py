"""What fields do to parcels: forces, equilibria, reduced laws."""
