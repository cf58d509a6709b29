"""The text of system files: TOML read within limits, the places of keys, and values taken out with their mistakes.

It knows no table of a system file.
"""
