"""The benches of time: how punctual each kind of context is, beside bare loops in Python and C; the paper's table."""
