"""The files that cross the layers: capture bundle, workspace artifacts, asset."""
