"""Cells that fall out of action, and what is done about them."""
