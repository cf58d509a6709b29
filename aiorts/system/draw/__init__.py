"""Draws a system file as Mermaid, DOT or SVG.

The layout depends on the file alone and is computed here; no drawing library is loaded.
"""
