"""The MCAP format: reading, writing, checking and salvaging files."""
