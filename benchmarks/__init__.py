"""Run time against error: modules for `impasto bench`, and scripts of their own."""
