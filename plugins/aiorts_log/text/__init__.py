"""The text formats: flat text, JSON lines, and tables (CSV)."""
