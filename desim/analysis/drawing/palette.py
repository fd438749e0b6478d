"""The colours and symbols of the players and messages, the same in all figures, the animation and the replay.

All hues except `LOST` and grey are those of Okabe & Ito 2008, "Color Universal Design"; colour-blind readers can
distinguish them. Shapes, sizes and line widths show most of the distinctions, too. The replay has these hues on a light
page, lighter ones on a dark page, and its own greys.
"""

ORANGE, SKY, GREEN, BLUE = "#E69F00", "#56B4E9", "#009E73", "#0072B2"
VERMILION, PURPLE, GREY = "#D55E00", "#CC79A7", "#999999"
SERIES = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
"""Colours of the lines of a diagram, in order."""
MARKERS = "osD^vPX"
"""Marks of the lines of a diagram, in order. Their number has no common divisor with that of `SERIES`, so 42 lines in a
row differ. Lines of one colour differ in their marks, for readers and printers that show no colour."""

ACTIVE = BLUE
"""A pursuer that chases an evader alone."""
ACTIVE_WITH_OTHERS = SKY
"""A pursuer that chases an evader together with others."""
INACTIVE = GREY
"""The outline of a pursuer that chases no evader; its inside is white."""
EVADER = VERMILION
IN_FLIGHT = ORANGE
"""A message between transmission and arrival."""
DELIVERED = GREEN
"""A message that arrived."""
LOST = "#D11A2A"
"""A message that was lost; it is always drawn dotted or as a cross."""
ON_DARK = {
    **{"#000000": "#e6e9ec", "#ffffff": "#14181e", "#555555": "#aab2ba", "#333333": "#c8ced4"},
    **{BLUE: "#3388ff", LOST: "#ff5a67"},
}
"""By colour of figures that is illegible on a dark page: the colour with the same meaning on a dark page."""

PURSUER_MARK = "o"
EVADER_MARK = "D"
CAPTURE_MARK = "*"
HANDOVER_MARK = "s"
"""The place and time at which a pursuer takes over the chase of an evader from another pursuer."""
LOST_MARK = "x"
COLLISION_MARK = (8, 2, 0)
"""A message that collided with others at its receiver: an asterisk of eight rays."""
EVADER_MARKS = (EVADER_MARK, "^", "v", "P")
"""Marks of the evaders, if there are several; they repeat from the fifth evader on."""
HUES = (BLUE, GREEN, PURPLE)
"""Hues of the pursuers that chase the first, second, ... of several evaders; they repeat from the fourth evader on."""
