"""`aiorts import` and `aiorts export`."""
