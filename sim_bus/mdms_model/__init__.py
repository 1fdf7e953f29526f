"""The table and what lies on it, as plain values and statics; no time passes here."""
