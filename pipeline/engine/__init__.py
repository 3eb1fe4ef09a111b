"""The stage engine: declared inputs and outputs, content hashes, skipping, atomic writes."""
