"""What pursuers see of evaders: noise, sightings, tracks, and the views from which a pursuer decides.

A view is all that a protocol may know of an evader. A new kind of noise is one class in `noise`.
"""
