"""Reads a system file into values: tables, keys, places in the text, and what is wrong with them.

Nothing is run that the file does not name a type for. Every error has its line.
"""
