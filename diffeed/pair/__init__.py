"""One body against one point or bar: geometry and contact law apart, no sums."""
