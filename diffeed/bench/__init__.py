"""What speed costs in accuracy, measured on the user's own scene; how cost grows; what each feature costs."""
