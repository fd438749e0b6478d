"""Figures and films of one run: paths, space-time diagram, link traces, animation."""
