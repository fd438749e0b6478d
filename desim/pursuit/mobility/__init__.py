"""Recorded paths from files: tables of times and places, ns-2, BonnMotion and SUMO.

A new format is one reader here; `mobility` chooses it and puts the places on one time axis.
"""
