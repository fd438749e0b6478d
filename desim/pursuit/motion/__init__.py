"""How players move: kinematics, inertia, flow, guidance, and when a pursuer captures an evader.

Pieces of paths are closed forms, so no time step limits their precision. A new body or flow is one class.
"""
