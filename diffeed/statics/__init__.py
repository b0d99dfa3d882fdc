"""What needs no steps: rest states and small vibrations."""
