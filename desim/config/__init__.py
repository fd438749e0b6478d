"""The base of all models: immutable objects, number types, choice by kind, copies, errors, untrusted input, signals.

This package imports no other package of desim.
"""
