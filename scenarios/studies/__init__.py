"""What the studies measure, and what all of them share: their options, and the files that they write.

Each study is a command, a module of the package `scenarios`. The scenarios and measurements of a new study are a module
here if other modules use them.
"""
