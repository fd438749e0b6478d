"""Commented starting files, which `desim new` copies under another name: each runs as it is."""
