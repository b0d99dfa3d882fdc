"""What a user hands in: the records of a scene, their checks, scene files, numbers by name."""
