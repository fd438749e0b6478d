"""When pursuers decide: periodically, at random, in rounds, all at once, or when they have the token or the mutex.

Every rule runs with every schedule. A new schedule is one class.
"""
