"""What is wrong with an array, why, and what helps."""
