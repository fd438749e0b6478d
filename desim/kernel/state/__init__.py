"""What a network remembers during a run: records and messages by receiver, faults in force, transmissions under way.

The layout of these tables decides speed and memory of large runs. Property tests compare them with plain messages.
"""
