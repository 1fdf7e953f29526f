"""What a table carries at rest: normal forces, margins of support, the limits of the paper."""
