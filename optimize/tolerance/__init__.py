"""Tolerance studies: from how the numbers of a scene scatter to how often it fails, and which tolerance is to blame."""
