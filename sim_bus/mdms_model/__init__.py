"""Table and parcels as plain values and statics; no time passes here."""
