"""The JSON Schema of system files, for editors.

It is made from the same tables that read the files.
"""
