"""Stages that turn a capture bundle into an asset."""
