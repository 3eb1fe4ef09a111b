"""Cameras, projector and turntable: what the bundle gives is taken, the rest comes from boards."""
