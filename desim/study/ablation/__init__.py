"""What each imperfection of a scenario costs: it is removed alone, and paired runs are compared.

A new kind of imperfection is one entry in `imperfections`.
"""
