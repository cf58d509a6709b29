"""Records what runs in another process."""
