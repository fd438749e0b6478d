"""The base of all models: immutable objects, number types, choice by kind, handling of untrusted files, JSON numbers.

This package imports no other package of desim.
"""
