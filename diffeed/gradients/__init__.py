"""Derivatives of a run, and whether they can be believed."""
