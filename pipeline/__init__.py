"""Stages that turn a capture bundle into an asset."""

__version__ = "0.1.0"
