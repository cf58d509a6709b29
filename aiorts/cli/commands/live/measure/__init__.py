"""Commands that measure what runs, by its counters: no sample is taken, and nothing in the kernel waits for them."""
