"""What every cell and every host agree on: identifiers, objects, frames."""
