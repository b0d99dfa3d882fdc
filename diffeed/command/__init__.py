"""What the commands share: set up, reports, files of a run."""
