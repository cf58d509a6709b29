"""The contents of the page: the kernels that are watched, one scene of all of them, and the figures of what is in view."""
