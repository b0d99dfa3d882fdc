"""A scene as arrays, in kg, mm, s."""
