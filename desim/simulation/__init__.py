"""One run: the moving world, the wiring of pursuers to the network, restartable processes, the watchdog.

Metrics and pictures are functions of the trace and live elsewhere.
"""
