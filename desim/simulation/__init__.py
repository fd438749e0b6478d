"""One run: the world that moves, the wiring of pursuers to the network, restartable processes, and the watchdog.

Metrics and pictures are made of its trace elsewhere.
"""
