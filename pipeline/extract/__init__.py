"""The canvas is cut out of the range image and becomes a height field."""
