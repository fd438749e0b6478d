"""Messages that must arrive: acknowledgements, retransmission, windows and duplicates, at both ends.

Its frames are messages on the links, like all others. A change here changes only scenarios whose transport is not plain
best effort.
"""
