"""Pursuers that lie: the kinds of lies, how they are sent, and the evidence by which others notice.

Honest runs do not use it. A new lie is one class in `lies`.
"""
