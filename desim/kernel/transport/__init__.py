"""Messages that must arrive: acknowledgements, retransmission, windows and duplicates, at both ends.

It uses the network like any other caller. A change here changes only scenarios with a reliable transport.
"""
