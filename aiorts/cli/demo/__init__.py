"""`aiorts demo`: a small system that runs from the installed package alone, and its files to start from."""
