"""The page's server: addresses, clients, and who may do what."""
