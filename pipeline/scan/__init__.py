"""The scan sequence becomes a range image."""
