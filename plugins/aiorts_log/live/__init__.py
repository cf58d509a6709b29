"""Records samples of a kernel in another process."""
