"""The chain of bars: what is stepped, where it stands, and the solution of its linear system."""
