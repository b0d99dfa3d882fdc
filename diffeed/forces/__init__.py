"""Forces by cause, their sum for a step, and their energies."""
