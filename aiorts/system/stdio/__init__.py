"""Connects ports with standard input and output as lines or frames, with back-pressure.

A bad line is reported with its number, and the others are processed.
"""
