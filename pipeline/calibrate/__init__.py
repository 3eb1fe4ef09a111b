"""Cameras, projector and turntable: what the bundle gives is taken, the rest is found from boards."""
