"""The bench of push policies: workloads, grids of options, the age of data, other libraries."""
