"""Colours and sizes of all figures.

All ink is one grey that a page replaces by the colour of its text; the other colours, orange and blue, are seen on
white and on black, and by the colour-blind.
"""

INK, ORANGE, BLUE, MAGENTA = "#767676", "#cc6a1a", "#2b83c6", "#c2408f"
WIDTH = 5.4
"""in; two figures fit side by side on a page, one on a telephone."""
SIZE = 10.0
"""Of letters, points."""
