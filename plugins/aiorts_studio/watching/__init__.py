"""The contents of the page: the kernels that are watched, one scene of all of them, and their figures."""
