"""System files as people write them: included files, variables, parts with a condition, parts that are repeated.

All of it is expanded before any other step: the result is one system, and the place of each of its keys.
"""
