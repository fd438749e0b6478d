"""Who may transmit when: queues, carrier sense, contention for a shared channel, and the methods of access.

A new method of access is one class in `access_methods` and its parameters in `models.access`.
"""
