"""The style of all pictures: colours, sizes, labels; and how a figure becomes a file."""

from io import BytesIO

from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Okabe and Ito's colours, told apart with any colour vision.
BLACK, ORANGE, SKY, GREEN, BLUE, RED, PURPLE = (
    "#000000",
    "#e69f00",
    "#56b4e9",
    "#009e73",
    "#0072b2",
    "#d55e00",
    "#cc79a7",
)
ALPHA_LABEL = r"stiffness  $\alpha = K\,T^2/m$"
BETA_LABEL = r"damping  $\beta = B\,T/m$"
FORMATS = ("png", "svg")

_PANEL = (4.2, 3.5)  # inches
_DOTS_PER_INCH = 150


def panels(
    rows: int, columns: int, width: float = 1.0, height: float = 1.0
) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure with panels of the (alpha, beta) plane, row by row."""
    size = (_PANEL[0] * columns * width, (_PANEL[1] * rows + 0.4) * height)
    figure = Figure(figsize=size)
    figure.set_layout_engine("constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    for panel in grid[-1]:
        panel.set_xlabel(ALPHA_LABEL)
    for panel in grid[:, 0]:
        panel.set_ylabel(BETA_LABEL)
    for panel in grid.flat:
        panel.tick_params(labelsize=9)
        panel.grid(visible=True, color="#dddddd", linewidth=0.6)
        panel.set_axisbelow(True)
        panel.spines[["top", "right"]].set_visible(False)
    return figure, [list(row) for row in grid]


def hand_label(gamma: float, delta: float) -> str:
    """Return the hand of a slice, in the letters of the paper."""
    return rf"$\gamma = {gamma:g}$, $\delta = {delta:g}$"


def plain(text: str) -> str:
    """Return a text that matplotlib shows as it is: a dollar sign begins no formula."""
    return text.replace("$", r"\$")


def picture(figure: Figure, form: str) -> bytes:
    """Return a figure as a file of the format "png" or "svg".

    Raises:
        ValueError: another format.
    """
    if form not in FORMATS:
        raise ValueError(f"the format is {form!r}; give a name that ends in .png or .svg.")
    image = BytesIO()
    figure.savefig(image, format=form, dpi=_DOTS_PER_INCH)
    return image.getvalue()
