"""Everything a renderer needs becomes the asset."""
