"""What the studies measure, and what all of them share: their options, and the files that they write.

A study is a command beside this room. A new one is a module there, and its scenarios and measurements are a module
here if others use them.
"""
