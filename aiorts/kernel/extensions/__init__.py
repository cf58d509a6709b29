"""Extensions: what installed packages and plugin folders offer, listed without importing, loaded when used.

`Catalogue` lists, `loading.py` imports, `finders.py` answers for names that nobody knows. They come from the entry
points `aiorts.<kind>` and from folders that the user names.
"""
