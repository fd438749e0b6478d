"""Checks of what users write."""
