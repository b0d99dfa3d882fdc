"""What pictures, player and notebooks share."""
