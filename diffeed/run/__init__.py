"""From a scene to a trajectory: `simulate`, error control, runs in pieces; and what `check` says."""
