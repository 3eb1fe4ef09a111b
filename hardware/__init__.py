"""Devices that take a capture: they write a capture bundle."""
