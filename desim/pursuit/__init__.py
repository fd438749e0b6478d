"""The pursuit game and its players: mathematics over numpy, but for the agent that plays it."""
