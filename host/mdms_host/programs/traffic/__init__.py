"""Many parcels under way: orders become routes, and routes motion, by host or by cells."""
