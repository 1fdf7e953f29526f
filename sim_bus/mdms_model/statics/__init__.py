"""The loads of a table at rest: normal forces, margins of support, the limits of the paper."""
