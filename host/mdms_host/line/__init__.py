"""The table as a machine of a plant: states, orders, figures, and the protocols that show them."""
