"""Report and figure of a study."""

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def reported(study, rows):
    """Its report; its figure has been drawn."""
    figure = Figure()
    FigureCanvasAgg(figure)
    study.draw(rows, figure)
    figure.canvas.draw()
    return study.report(rows)
