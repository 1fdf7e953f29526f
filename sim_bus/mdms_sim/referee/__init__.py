"""A referee that knows the truth and the documented rules, and judges every simulated run."""
