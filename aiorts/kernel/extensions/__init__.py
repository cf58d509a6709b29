"""Extensions: what installed packages and plugin folders offer, listed without importing, loaded when used.

`Catalogue` lists, `loading.py` imports, `finders.py` finds names that are not loaded. They come from the entry
points `aiorts.<kind>` and from folders that the user names.
"""
