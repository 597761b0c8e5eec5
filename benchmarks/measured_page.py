"""The page docs/measured.md: its tables and its picture, of the rows of ``benchmarks.measured``."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.record import Row
from benchmarks.table import of_cells, put_between

PAGE = Path(__file__).parents[1] / "docs" / "measured.md"
MARKER = "written by python -m benchmarks measured: {} {}"
ESTIMATORS = {
    "difference_low_pass": "difference, low pass",
    "foaw": "FOAW",
    "levant": "Levant",
    "kalman": "Kalman",
}


def write(found: list[Row]) -> None:
    """Put tables and picture into the page."""
    draw(found).savefig(PAGE.with_suffix(".png"), dpi=110)
    put_between(PAGE, MARKER, tables(found))


def tables(found: list[Row]) -> dict[str, str]:
    """The tables in Markdown, by name; the fit with the worst prediction first."""
    fits: dict[tuple[str, ...], dict[str, float]] = {}
    for row in found:
        if row["section"] != "rate":
            key = row["section"], row["fitted_to"], row["paddle"]
            fits.setdefault(key, {})[row["estimator"]] = row["error"]
    errors = []
    for (model, fit, paddle), by_name in sorted(
        fits.items(), key=lambda item: -max(item[1].values())
    ):
        cells = (
            f"{100.0 * by_name[name]:.0f} %{' (fitted)' * (fit in (words, 'all four'))}"
            for name, words in ESTIMATORS.items()
        )
        errors.append((model, fit, *cells, paddle))
    of_rates = [row for row in found if row["section"] == "rate"]
    rates = [("Choi and Tan", *_in_mm(of_rates[0], "measured"))]
    rates += [(row["method"], *_in_mm(row, "limits")) for row in of_rates]
    return {
        "errors": of_cells(
            ("model", "fitted to", *ESTIMATORS.values(), "the fitted paddle"), errors
        ),
        "rates": of_cells(("largest K in N/mm", "250 Hz", "40 kHz"), rates),
    }


def _in_mm(row: Row, column: str) -> list[str]:
    return [f"{1e-3 * float(stiffness):.3g}" for stiffness in row[column].split()]


def draw(found: list[Row]) -> Figure:
    """Measured points with linear and simulated limits, a panel for each estimator."""
    colors = {"linear": "#0072B2", "simulated": "#D55E00"}  # Okabe and Ito's
    dashes = {ESTIMATORS["difference_low_pass"]: "-", ESTIMATORS["kalman"]: "--"}
    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    for panel, (name, words) in zip(panels.flat, ESTIMATORS.items(), strict=True):
        shown = [row for row in found if row.get("estimator") == name]
        damping, measured = (np.array(shown[0][key].split(), float) for key in ("at", "measured"))
        panel.plot(damping, measured, "ko", label="measured")
        for row in shown:
            if row["fitted_to"] in dashes:
                limits, label = np.array(row["limits"].split(), float), row["fitted_to"]
                panel.plot(
                    damping, limits, dashes[label], color=colors[row["section"]],
                    label=f"{row['section']}, fitted to: {label}",
                )  # fmt: skip
        panel.set(title=words, ylim=(-0.2, 10.2))
        panel.grid(visible=True, alpha=0.3)
    figure.supxlabel("damping of the wall B (N m s/deg)")
    figure.supylabel("largest stiffness of the wall K (N m/deg)")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False)
    return figure
