"""The commands `aiorts log ...`."""
