"""Structured light: frames of patterns become projector coordinates, and those become points."""
