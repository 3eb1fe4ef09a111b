"""Photographs become samples of reflectance per texel."""
