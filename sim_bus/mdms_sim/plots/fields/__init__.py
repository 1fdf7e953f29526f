"""Maps of fields, and plans of squeezes."""
