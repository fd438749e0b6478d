"""Experiments: scenario files, and studies that print a table and draw a figure."""
