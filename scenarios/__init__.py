"""Scenario files, and the studies of the README.

A study is a script over the public API.
"""
