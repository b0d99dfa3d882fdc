"""What makes a run not to be believed."""
