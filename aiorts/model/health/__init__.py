"""How a system did in a window of time, as values, and whether it did worse in one window than in the one before."""
