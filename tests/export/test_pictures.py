"""Pictures keep every colour that was drawn."""

import colorsys

from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from PIL import Image

from export.study.pictures import picture
from export.verification.pictures import save

MANY = [to_hex(colorsys.hsv_to_rgb(i / 300, 1.0, 1.0)) for i in range(300)]


def crowd(figure):
    """Draw a patch of each of many colours."""
    axes = figure.add_subplot()
    axes.set_axis_off()
    axes.set_xlim(0, len(MANY))
    for i, colour in enumerate(MANY):
        axes.axvspan(i, i + 1, facecolor=colour, linewidth=0.0, antialiased=False)


def colours(path):
    with Image.open(path) as drawn:
        return {to_hex([part / 255 for part in colour]) for _, colour in drawn.convert("RGB").getcolors(1 << 20)}


def test_no_colour_is_lost(tmp_path):
    with picture("crowd", tmp_path) as figure:
        crowd(figure)
    assert set(MANY) <= colours(tmp_path / "crowd.png")
    figure = Figure(figsize=(8.0, 4.0))
    crowd(figure)
    assert set(MANY) <= colours(save(figure, tmp_path / "other.png"))
