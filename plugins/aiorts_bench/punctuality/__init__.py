"""The benches of time: how punctual each kind of context is, next to bare loops in Python and C; the paper's table."""
