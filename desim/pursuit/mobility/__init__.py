"""Recorded paths from files: tables of times and places, ns-2, BonnMotion and SUMO.

A new format is one reader here; `mobility_file` chooses it by the content of the file.
"""
