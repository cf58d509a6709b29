"""The pure parts of the server: values as JSON, errors as HTTP has them, limits of what clients may ask."""
