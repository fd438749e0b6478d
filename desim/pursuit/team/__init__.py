"""What pursuers tell and know of each other: announcements, beliefs, trust, and the agent that a protocol controls.

The public methods of `Agent` are what protocols of other people call, so they change last.
"""
