"""Programs that draw an asset."""
