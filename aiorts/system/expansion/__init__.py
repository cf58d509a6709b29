"""Expands system files: included files, variables, parts with a condition, parts that are repeated.

Expansion comes before any other step. Its result is one system without these means, and the place of each of its keys.
"""
