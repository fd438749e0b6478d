"""From traces and results to numbers, tables and pictures."""
