"""From a scene to a trajectory: rest states, steps, error control, pieces."""
