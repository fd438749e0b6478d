"""Reproduce Table I of Lee & Bakolas: the sum of active times, centralised and decentralised, for N = 20 and 40."""
DELTAS = (0.1, 0.01, 0.001)
PUBLISHED = {
    ("centralised", 20, 0.1): 4.6000,
    ("centralised", 20, 0.01): 4.5700,
    ("centralised", 20, 0.001): 4.5580,
    ("centralised", 40, 0.1): 4.8000,
    ("centralised", 40, 0.01): 4.6900,
    ("centralised", 40, 0.001): 4.6700,
    ("decentralised", 20, 0.1): 55.5900,
    ("decentralised", 20, 0.01): 11.6580,
    ("decentralised", 20, 0.001): 5.2088,
    ("decentralised", 40, 0.1): 116.4590,
    ("decentralised", 40, 0.01): 39.0082,
    ("decentralised", 40, 0.001): 7.9598,
}
from desim.scenario import *
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules import SharedSeed
def decentralised(s, delta):
    return s.model_copy(update={"motion":Motion(step=delta),"protocol":SpatialAdaptivePlay(schedule=SharedSeed(slot=delta))})
