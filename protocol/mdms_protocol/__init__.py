"""The wire, shared by every cell and every host: identifiers, objects, frames."""
