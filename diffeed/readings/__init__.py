"""What is read off a run: frames, observations, the verdict."""
