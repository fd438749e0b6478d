"""The base of all models: immutable objects, number types, choice by kind, untrusted files, JSON numbers, signals.

This package imports no other package of desim.
"""
