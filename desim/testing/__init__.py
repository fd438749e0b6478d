"""Checks that hold in every run: of messages, and of pursuits.

A watcher sees every event and raises an error at the first that breaks a law.
"""
