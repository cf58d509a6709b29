"""Commands that look into what runs and change nothing; what a word means to them, and reports as text."""
