"""The page that shows a workspace."""
