"""Commands that measure running systems by their counters: they take no sample, and nothing in the kernel waits."""
