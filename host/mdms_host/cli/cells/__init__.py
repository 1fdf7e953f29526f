"""Verbs that look after the cells of an array, from the first board on."""
