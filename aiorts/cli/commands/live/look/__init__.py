"""Commands that look into running kernels and change nothing; the meaning of their words, and reports as text."""
