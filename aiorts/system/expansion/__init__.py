"""System files as people write them: included files, variables, parts with a condition, parts that are repeated.

All of it is expanded before anything else looks: what comes out is one system, and where each of its keys stands.
"""
