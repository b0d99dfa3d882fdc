"""Searches for faults that a fixed list of tests does not find: `python -m tests.search COMMAND --help`."""
